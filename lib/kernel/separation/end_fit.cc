// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../clones.h"
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
    std::vector<complex> gram(n * n);
    for (std::size_t group = 0; group < of.groups; group++) {
        const complex* const matrix = mixing.data() + group * of.tones * n;
        std::fill(gram.begin(), gram.end(), 0.0);
        for (std::size_t tone = 0; tone < of.tones; tone++)
            for (std::size_t row = 0; row < n; row++)
                add_scaled(std::conj(matrix[tone * n + row]),
                           matrix + tone * n,
                           n,
                           &gram[row * n]);
        const auto inverse = inverse_of(gram, n);
        complex* const solved = solver.data() + group * of.tones * n;
        for (std::size_t end = 0; end < n; end++) {
            gain[group * n + end] = inverse[end * n + end].real();
            for (std::size_t tone = 0; tone < of.tones; tone++)
                solved[end * of.tones + tone] =
                    inner_product(matrix + tone * n, &inverse[n * end], n);
        }
    }
    solve(tones);
}

WIFORCE_CLONES
void end_fit::solve(const complex* tones)
{
    const auto [groups, count, columns, subcarriers] = sizes;
    std::fill(ends.begin(), ends.end(), 0.0);
    std::copy_n(tones, residual.size(), residual.begin());
    for (std::size_t group = 0; group < groups; group++) {
        complex* const rest = residual.data() + group * count * subcarriers;
        complex* const found = ends.data() + group * columns * subcarriers;
        for (std::size_t end = 0; end < columns; end++)
            for (std::size_t tone = 0; tone < count; tone++)
                add_scaled(solver[(group * columns + end) * count + tone],
                           rest + tone * subcarriers,
                           subcarriers,
                           found + end * subcarriers);
        for (std::size_t tone = 0; tone < count; tone++)
            for (std::size_t end = 0; end < columns; end++)
                add_scaled(-mixing[(group * count + tone) * columns + end],
                           found + end * subcarriers,
                           subcarriers,
                           rest + tone * subcarriers);
    }
}

WIFORCE_CLONES
double whiten(const std::complex<double>* whitener,
              const std::complex<double>* tones,
              std::size_t count,
              std::size_t subcarriers,
              std::complex<double>* white)
{
    double power = 0;
    for (std::size_t row = 0; row < count; row++) {
        std::complex<double>* const to = white + row * subcarriers;
        std::fill_n(to, subcarriers, 0.0);
        for (std::size_t tone = 0; tone <= row; tone++)
            add_scaled(whitener[row * count + tone],
                       tones + tone * subcarriers,
                       subcarriers,
                       to);
        power += inner_product(to, to, subcarriers).real();
    }
    return power / double(std::max<std::size_t>(count * subcarriers, 1));
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
    std::vector<complex> matched(subcarriers);
    for (std::size_t row = 0; row < groups * columns; row++) {
        const std::size_t group = row / columns;
        const complex* const channel = &ends[row * subcarriers];
        for (std::size_t k = 0; k < subcarriers; k++)
            matched[k] = channel[k] * inverse_noise[group * subcarriers + k];
        const double energy =
            std::max(inner_product(matched.data(), channel, subcarriers).real(), 1e-300);
        double errors = 0, shares = 0, sum = 0;
        for (std::size_t tone = 0; tone < count; tone++) {
            const std::size_t place = group * count + tone;
            const double along =
                std::norm(inner_product(
                    matched.data(), &residual[place * subcarriers], subcarriers)) /
                energy;
            double leverage = 0;
            for (std::size_t each = 0; each < columns; each++)
                leverage += (mixing[place * columns + each] *
                             solver[(group * columns + each) * count + tone])
                                .real();
            const double share = std::norm(solver[row * count + tone]);
            errors += share * along / std::max(1 - leverage, 0.1);
            shares += share;
            sum += along;
        }
        found.sandwich[row] = errors / shares;
        found.mean[row] = sum / freedom();
    }
    return found;
}

} // namespace gr::wiforce::kernel
