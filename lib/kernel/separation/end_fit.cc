// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../clones.h"
#include "complex_product.h"
#include "complex_rows.h"
#include "hermitian.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

end_fit::end_fit(const shape& of, const complex* mixed, const complex* tones)
    : sizes(of),
      mixing(of.groups * of.tones * of.ends),
      slopes(mixing.size()),
      solver(mixing.size()),
      gain(of.groups * of.ends),
      ends(of.groups * of.ends * of.subcarriers),
      residual(of.groups * of.tones * of.subcarriers)
{
    const std::size_t n = of.ends;
    for (std::size_t row = 0; row < of.groups * of.tones; row++) {
        std::copy_n(mixed + 2 * n * row, n, mixing.data() + n * row);
        std::copy_n(mixed + 2 * n * row + n, n, slopes.data() + n * row);
    }
    invert();
    solve(tones);
}

WIFORCE_CLONES
void end_fit::invert()
{
    const std::size_t n = sizes.ends, tones = sizes.tones;
    std::vector<complex> gram(n * n), adjoint(n * tones);
    std::vector<double> packed;
    for (std::size_t group = 0; group < sizes.groups; group++) {
        const complex* const matrix = mixing.data() + group * tones * n;
        std::fill(gram.begin(), gram.end(), 0.0);
        add_product({ matrix, 1, n, 1, true }, n, tones, matrix, n, gram.data(), packed);
        const auto inverse = inverse_of(gram, n);
        for (std::size_t end = 0; end < n; end++) {
            gain[group * n + end] = inverse[end * n + end].real();
            for (std::size_t tone = 0; tone < tones; tone++)
                adjoint[end * tones + tone] = std::conj(matrix[tone * n + end]);
        }
        add_product({ inverse.data(), n, 1 },
                    n,
                    n,
                    adjoint.data(),
                    tones,
                    &solver[group * n * tones],
                    packed);
    }
}

WIFORCE_CLONES
void end_fit::solve(const complex* tones)
{
    const auto [groups, count, columns, subcarriers] = sizes;
    std::fill(ends.begin(), ends.end(), 0.0);
    std::copy_n(tones, residual.size(), residual.begin());
    std::vector<double> packed;
    for (std::size_t group = 0; group < groups; group++) {
        complex* const rest = residual.data() + group * count * subcarriers;
        complex* const found = ends.data() + group * columns * subcarriers;
        const std::size_t first = group * count * columns;
        add_product({ &solver[first], count, 1 },
                    columns,
                    count,
                    rest,
                    subcarriers,
                    found,
                    packed);
        add_product({ &mixing[first], columns, 1, -1 },
                    count,
                    columns,
                    found,
                    subcarriers,
                    rest,
                    packed);
    }
}

WIFORCE_CLONES
double whiten(const std::complex<double>* whitener,
              const std::complex<double>* tones,
              std::size_t count,
              std::size_t subcarriers,
              std::complex<double>* white)
{
    std::fill_n(white, count * subcarriers, 0.0);
    left_factor factor{ whitener, count, 1 };
    factor.triangular = true;
    std::vector<double> packed;
    add_product(factor, count, count, tones, subcarriers, white, packed);
    return power_of(white, count * subcarriers) /
           double(std::max<std::size_t>(count * subcarriers, 1));
}

std::size_t end_fit::freedom() const
{
    return sizes.tones > sizes.ends ? sizes.tones - sizes.ends : 1;
}

WIFORCE_CLONES
std::vector<double> end_fit::power() const
{
    const auto [groups, count, columns, subcarriers] = sizes;
    std::vector<double> sums(groups * subcarriers);
    for (std::size_t row = 0; row < groups * count; row++)
        add_powers(
            &residual[row * subcarriers], subcarriers, &sums[row / count * subcarriers]);
    return sums;
}

WIFORCE_CLONES
end_fit::coherence end_fit::coherent(const double* inverse_noise) const
{
    const auto [groups, count, columns, subcarriers] = sizes;
    coherence found{ std::vector<double>(groups * columns),
                     std::vector<double>(groups * columns) };
    std::vector<complex> matched(subcarriers * columns), along(count * columns);
    std::vector<double> energy(columns), leverage(count), packed;
    for (std::size_t group = 0; group < groups; group++) {
        const complex* const channels = &ends[group * columns * subcarriers];
        const complex* const responses = &mixing[group * count * columns];
        const complex* const solvers = &solver[group * count * columns];
        std::fill(energy.begin(), energy.end(), 1e-300);
        for (std::size_t end = 0; end < columns; end++)
            for (std::size_t k = 0; k < subcarriers; k++) {
                const complex value = channels[end * subcarriers + k];
                const double weight = inverse_noise[group * subcarriers + k];
                matched[k * columns + end] = std::conj(value) * weight;
                energy[end] += weight * std::norm(value);
            }
        std::fill(along.begin(), along.end(), 0.0);
        add_product({ &residual[group * count * subcarriers], subcarriers, 1 },
                    count,
                    subcarriers,
                    matched.data(),
                    columns,
                    along.data(),
                    packed);
        std::fill(leverage.begin(), leverage.end(), 0.0);
        for (std::size_t tone = 0; tone < count; tone++)
            for (std::size_t end = 0; end < columns; end++)
                leverage[tone] += real_product(std::conj(responses[tone * columns + end]),
                                               solvers[end * count + tone]);
        for (std::size_t end = 0; end < columns; end++) {
            double errors = 0, shares = 0, sum = 0;
            for (std::size_t tone = 0; tone < count; tone++) {
                const double power = std::norm(along[tone * columns + end]) / energy[end];
                const double share = std::norm(solvers[end * count + tone]);
                errors += share * power / std::max(1 - leverage[tone], 0.1);
                shares += share;
                sum += power;
            }
            found.sandwich[group * columns + end] = errors / shares;
            found.mean[group * columns + end] = sum / freedom();
        }
    }
    return found;
}

} // namespace gr::wiforce::kernel
