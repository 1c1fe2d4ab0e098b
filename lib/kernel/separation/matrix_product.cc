// SPDX-License-Identifier: GPL-3.0-or-later
#include "matrix_product.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

using matrix_of = std::vector<double>;

// Eigenvalues of a singular matrix below this part of the largest one are zero.
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
void pseudo_invert(const matrix_of& matrix, std::size_t size, matrix_of& inverse)
{
    auto a = matrix;
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
    std::fill(inverse.begin(), inverse.end(), 0.0);
    for (std::size_t i = 0; i < size; i++) {
        const double value = a[i * size + i];
        if (!(std::abs(value) > negligible * largest))
            continue;
        const double* const vector = &vectors[i * size];
        for (std::size_t row = 0; row < size; row++)
            for (std::size_t column = 0; column < size; column++)
                inverse[row * size + column] += vector[row] * vector[column] / value;
    }
}

} // namespace

std::vector<double> inverse_of(const matrix_of& matrix, std::size_t n, double singular)
{
    auto inverse = matrix;
    double energy = 0, gain = 0;
    if (invert(inverse, n))
        for (std::size_t i = 0; i < n; i++) {
            // An element on the inverse's diagonal is 1 over what the other columns leave
            // of its own.
            gain = std::max(gain, inverse[i * n + i]);
            energy = std::max(energy, matrix[i * n + i]);
        }
    else
        gain = energy = singular;
    if (!(gain * energy < singular))
        pseudo_invert(matrix, n, inverse);
    return inverse;
}

} // namespace gr::wiforce::kernel
