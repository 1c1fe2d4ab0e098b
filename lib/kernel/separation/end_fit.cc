// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../algebra/complex_rows.h"
#include "../algebra/matrix_product.h"
#include "../algebra/symmetric.h"
#include "../clones.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

end_fit::end_fit(const shape& of, const double* mixed, const complex* tones)
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
    std::vector<double> gram(n * n), transposed(n * tones), packed;
    for (std::size_t group = 0; group < sizes.groups; group++) {
        const double* const matrix = mixing.data() + group * tones * n;
        std::fill(gram.begin(), gram.end(), 0.0);
        add_product({ matrix, 1, n }, n, tones, matrix, n, gram.data(), packed);
        const auto inverse = inverse_of(gram, n);
        for (std::size_t end = 0; end < n; end++) {
            gain[group * n + end] = inverse[end * n + end];
            for (std::size_t tone = 0; tone < tones; tone++)
                transposed[end * tones + tone] = matrix[tone * n + end];
        }
        add_product({ inverse.data(), n, 1 },
                    n,
                    n,
                    transposed.data(),
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
    // Complex products in real ones: along = residual x matched, whose rows are of the
    // real and of the imaginary parts.
    std::vector<double> matched(subcarriers * columns * 4), along(count * columns * 2);
    std::vector<double> energy(columns), leverage(count), packed;
    for (std::size_t group = 0; group < groups; group++) {
        const complex* const channels = &ends[group * columns * subcarriers];
        const double* const responses = &mixing[group * count * columns];
        const double* const solvers = &solver[group * count * columns];
        std::fill(energy.begin(), energy.end(), 1e-300);
        for (std::size_t k = 0; k < subcarriers; k++) {
            const double weight = inverse_noise[group * subcarriers + k];
            double* const by_real = &matched[4 * k * columns];
            double* const by_imag = by_real + 2 * columns;
            for (std::size_t end = 0; end < columns; end++) {
                const complex value = channels[end * subcarriers + k];
                const double real = weight * value.real(), imag = weight * value.imag();
                by_real[2 * end] = by_imag[2 * end + 1] = real;
                by_real[2 * end + 1] = -imag;
                by_imag[2 * end] = imag;
                energy[end] += real * value.real() + imag * value.imag();
            }
        }
        std::fill(along.begin(), along.end(), 0.0);
        add_product(
            { reinterpret_cast<const double*>(&residual[group * count * subcarriers]),
              2 * subcarriers,
              1 },
            count,
            2 * subcarriers,
            matched.data(),
            2 * columns,
            along.data(),
            packed);
        std::fill(leverage.begin(), leverage.end(), 0.0);
        for (std::size_t tone = 0; tone < count; tone++)
            for (std::size_t end = 0; end < columns; end++)
                leverage[tone] +=
                    responses[tone * columns + end] * solvers[end * count + tone];
        const auto power_at = [&](std::size_t tone, std::size_t end) {
            const double* const value = &along[2 * (tone * columns + end)];
            return (value[0] * value[0] + value[1] * value[1]) / energy[end];
        };
        for (std::size_t end = 0; end < columns; end++) {
            const double* const own = solvers + end * count;
            double errors = 0, shares = 0, sum = 0;
            for (std::size_t tone = 0; tone + 1 < count; tone += 2) {
                const double power = power_at(tone, end) + power_at(tone + 1, end);
                const double share =
                    own[tone] * own[tone] + own[tone + 1] * own[tone + 1];
                const double left = 1 - (leverage[tone] + leverage[tone + 1]) / 2;
                errors += share / 2 * power / std::max(left, 0.1);
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
