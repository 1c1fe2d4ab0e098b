// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>

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
    std::vector<double> gram(n * n), transpose(n * tones);
    for (std::size_t group = 0; group < sizes.groups; group++) {
        const double* const matrix = mixing.data() + group * tones * n;
        std::fill(gram.begin(), gram.end(), 0.0);
        add_product({ matrix, n, tones, 1, n }, matrix, n, gram.data());
        const auto inverse = inverse_of(gram, n);
        for (std::size_t end = 0; end < n; end++) {
            gain[group * n + end] = inverse[end * n + end];
            for (std::size_t tone = 0; tone < tones; tone++)
                transpose[end * tones + tone] = matrix[tone * n + end];
        }
        add_product({ inverse.data(), n, n },
                    transpose.data(),
                    tones,
                    solver.data() + group * n * tones);
    }
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
        const std::size_t first = group * count * columns;
        add_product({ &solver[first], columns, count }, rest, subcarriers, found);
        add_product(
            { &mixing[first], count, columns, columns, 1, -1 }, found, subcarriers, rest);
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
    for (std::size_t row = 0; row < groups * count; row++) {
        double* const sum = &sums[row / count * subcarriers];
        const auto* const values =
            reinterpret_cast<const double*>(&residual[row * subcarriers]);
        for (std::size_t k = 0; k < subcarriers; k++)
            sum[k] +=
                values[2 * k] * values[2 * k] + values[2 * k + 1] * values[2 * k + 1];
    }
    return sums;
}

} // namespace gr::wiforce::kernel
