// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_fit.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

using matrix_of = std::vector<double>;

// Eigenvalues of a singular matrix below this part of the largest one are zero. A phase
// that the others leave less of its own information is taken together with them.
constexpr double negligible = 1e-9;

// In place, by Gauss and Jordan's elimination; false where a pivot is not positive.
bool invert(matrix_of& matrix, std::size_t n)
{
    for (std::size_t pivot = 0; pivot < n; pivot++) {
        double* const from = &matrix[pivot * n];
        const double scale = from[pivot];
        if (!(scale > 0))
            return false;
        from[pivot] = 1;
        for (std::size_t column = 0; column < n; column++)
            from[column] /= scale;
        for (std::size_t row = 0; row < n; row++) {
            double* const to = &matrix[row * n];
            if (row == pivot)
                continue;
            const double factor = std::exchange(to[pivot], 0.0);
            for (std::size_t column = 0; column < n; column++)
                to[column] -= factor * from[column];
        }
    }
    return true;
}

// By Jacobi's rotations.
matrix_of pseudo_inverse_of(matrix_of a, std::size_t size)
{
    std::vector<double> vectors(size * size);
    for (std::size_t row = 0; row < size; row++)
        vectors[row * size + row] = 1;
    for (int sweep = 0; sweep < 60; sweep++) {
        double beside = 0, along = 0;
        for (std::size_t p = 0; p < size; p++)
            for (std::size_t q = 0; q < size; q++)
                (p == q ? along : beside) += a[p * size + q] * a[p * size + q];
        if (beside <= 1e-30 * along)
            break;
        for (std::size_t p = 0; p < size; p++)
            for (std::size_t q = p + 1; q < size; q++) {
                if (a[p * size + q] == 0)
                    continue;
                const double half =
                    (a[q * size + q] - a[p * size + p]) / (2 * a[p * size + q]);
                const double tangent =
                    std::copysign(1.0, half) / (std::abs(half) + std::hypot(half, 1));
                const double cosine = 1 / std::hypot(tangent, 1), sine = tangent * cosine;
                const auto rotate = [=](double& x, double& y) {
                    const double first = x;
                    x = cosine * first - sine * y;
                    y = sine * first + cosine * y;
                };
                for (std::size_t i = 0; i < size; i++)
                    rotate(a[i * size + p], a[i * size + q]);
                for (std::size_t i = 0; i < size; i++) {
                    rotate(a[p * size + i], a[q * size + i]);
                    rotate(vectors[p * size + i], vectors[q * size + i]);
                }
            }
    }
    double largest = 0;
    for (std::size_t i = 0; i < size; i++)
        largest = std::max(largest, std::abs(a[i * size + i]));
    matrix_of inverse(size * size);
    for (std::size_t i = 0; i < size; i++) {
        const double value = a[i * size + i];
        if (!(std::abs(value) > negligible * largest))
            continue;
        const double* const vector = &vectors[i * size];
        for (std::size_t row = 0; row < size; row++)
            for (std::size_t column = 0; column < size; column++)
                inverse[row * size + column] += vector[row] * vector[column] / value;
    }
    return inverse;
}

// Inverse of a symmetric positive definite matrix, n x n row by row. Of a matrix that is
// singular within the accuracy of a fit, the pseudo-inverse. `singular`: largest energy
// of a column over what the others leave of one, from which on it is.
matrix_of inverse_of(const matrix_of& matrix, std::size_t n, double singular = 1e12)
{
    auto inverse = matrix;
    double energy = 0, gain = 0;
    const bool inverted = invert(inverse, n);
    for (std::size_t i = 0; i < n; i++) {
        // An element on the inverse's diagonal is 1 over what the other columns leave
        // of its own.
        gain = std::max(gain, inverse[i * n + i]);
        energy = std::max(energy, matrix[i * n + i]);
    }
    if (inverted && gain * energy < singular)
        return inverse;
    return pseudo_inverse_of(matrix, n);
}

} // namespace

end_fit::end_fit(const shape& of, const double* mixed)
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
