// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

// Part of its own information that a phase is left by the others, below which all are
// taken together.
constexpr double negligible = 1e-9;

} // namespace

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

WIFORCE_CLONES
phase_information information_of(const end_fit& fit, const double* inverse_noise)
{
    const auto [groups, tones, ends, subcarriers] = fit.sizes;
    const std::size_t tags = ends / 2;
    phase_information found{ std::vector<double>(groups * tags),
                             std::vector<double>(groups * tags * tags),
                             std::vector<double>(groups * tags) };
    std::vector<double> moved(ends * ends), changes(tones * ends), gram(ends * ends);
    std::vector<complex> along(ends * subcarriers), weighted(subcarriers);
    for (std::size_t group = 0; group < groups; group++) {
        const double* const solver = fit.solver.data() + group * ends * tones;
        const double* const mixing = fit.mixing.data() + group * tones * ends;
        const double* const slopes = fit.slopes.data() + group * tones * ends;
        const complex* const channels = fit.ends.data() + group * ends * subcarriers;
        double* const gradient = found.gradient.data() + group * tags;
        double* const expected = found.expected.data() + group * tags * tags;
        double* const excess = found.excess.data() + group * tags;
        // By what the ends change, and what the tones then still do; a column per end.
        std::fill(moved.begin(), moved.end(), 0.0);
        add_product({ solver, ends, tones }, slopes, ends, moved.data());
        std::copy_n(slopes, changes.size(), changes.begin());
        add_product(
            { mixing, tones, ends, ends, 1, -1 }, moved.data(), ends, changes.data());
        const left_factor changed{ changes.data(), ends, tones, 1, ends };
        std::fill(gram.begin(), gram.end(), 0.0); // t^T t without the ends
        add_product(changed, changes.data(), ends, gram.data());
        std::fill(along.begin(), along.end(), 0.0);
        add_product(changed,
                    &fit.residual[group * tones * subcarriers],
                    subcarriers,
                    along.data());
        for (std::size_t row = 0; row < ends; row++) {
            const complex* const own = channels + row * subcarriers;
            for (std::size_t k = 0; k < subcarriers; k++) {
                weighted[k] = own[k] * inverse_noise[k];
                gradient[row / 2] +=
                    2 * real_product(weighted[k], along[row * subcarriers + k]);
            }
            for (std::size_t column = row / 2 * 2; column < row / 2 * 2 + 2; column++)
                excess[row / 2] += 2 * subcarriers * gram[row * ends + column] *
                                   std::inner_product(solver + row * tones,
                                                      solver + (row + 1) * tones,
                                                      solver + column * tones,
                                                      0.0);
            for (std::size_t column = row; column < ends; column++) {
                const complex* const other = channels + column * subcarriers;
                double product = 0;
                for (std::size_t k = 0; k < subcarriers; k++)
                    product += real_product(weighted[k], other[k]);
                product *= 2 * gram[row * ends + column];
                expected[row / 2 * tags + column / 2] += product;
                if (column > row)
                    expected[column / 2 * tags + row / 2] += product;
            }
        }
        for (std::size_t tag = 0; tag < tags; tag++)
            expected[tag * tags + tag] -= excess[tag];
    }
    return found;
}

std::vector<clock_tracker::measurement> phase_errors(const phase_information& of)
{
    const std::size_t count = of.gradient.size();
    std::vector<clock_tracker::measurement> errors(
        count, { 0.0, std::numeric_limits<double>::infinity() });
    std::vector<double> scale(count);
    for (std::size_t i = 0; i < count; i++) {
        const double own = of.expected[i * count + i];
        if (!(own > 0))
            return errors;
        scale[i] = 1 / std::sqrt(own);
    }
    auto inverse = of.expected;
    for (std::size_t i = 0; i < inverse.size(); i++)
        inverse[i] *= scale[i / count] * scale[i % count];
    inverse = inverse_of(inverse, count, 1 / negligible);
    for (std::size_t i = 0; i < inverse.size(); i++)
        inverse[i] *= scale[i / count] * scale[i % count];
    for (std::size_t row = 0; row < count; row++) {
        const double* const own = &inverse[row * count];
        double error = 0, variance = 0;
        // The diagonal of inverse x (expected + excess) x inverse.
        for (std::size_t i = 0; i < count; i++) {
            double product = own[i] * of.excess[i];
            for (std::size_t j = 0; j < count; j++)
                product += own[j] * of.expected[j * count + i];
            error += own[i] * of.gradient[i];
            variance += product * own[i];
        }
        errors[row] = { error, variance };
    }
    return errors;
}

} // namespace gr::wiforce::kernel
