// SPDX-License-Identifier: GPL-3.0-or-later
#include "slepian_sequences.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

using values = std::vector<double>;

constexpr double precision = std::numeric_limits<double>::epsilon();
constexpr double pi = 3.14159265358979323846;
// Part of the norm to which eigenvalues are found. They are about 1 / N of it apart, so
// that inverse iteration leaves one part in 1e5 or less with each step.
constexpr double tolerance = 1e-9;
constexpr int iterations = 4;

// A symmetric tridiagonal matrix.
struct tridiagonal {
    values diagonal, beside; // N, N - 1
    double norm;             // of its largest row

    // Eigenvalues below x: negative pivots of T - x (W. Givens, 1954).
    std::size_t below(double x) const
    {
        std::size_t count = 0;
        double pivot = 1;
        for (std::size_t i = 0; i < diagonal.size(); i++) {
            const double other = i ? beside[i - 1] * beside[i - 1] / pivot : 0.0;
            pivot = diagonal[i] - x - other;
            if (std::abs(pivot) < precision * precision * norm)
                pivot = -precision * precision * norm;
            count += pivot < 0;
        }
        return count;
    }

    // The eigenvalue that so many are below.
    double eigenvalue(std::size_t index, double upper) const
    {
        double lower = -norm;
        while (true) {
            const double middle = (lower + upper) / 2;
            if (upper - lower <= 2 * tolerance * norm)
                return middle;
            (below(middle) > index ? upper : lower) = middle;
        }
    }
};

// Factors of T - x with row exchanges, to solve for right sides.
class shifted_solver
{
public:
    shifted_solver(const tridiagonal& of, double x)
        : d_pivots(of.diagonal),
          d_above(of.beside),
          d_second(of.diagonal.size(), 0.0),
          d_factors(of.beside.size()),
          d_exchanged(of.beside.size())
    {
        const std::size_t count = d_pivots.size();
        const double least = precision * of.norm;
        d_above.push_back(0.0);
        for (double& pivot : d_pivots)
            pivot -= x;
        for (std::size_t i = 0; i + 1 < count; i++) {
            const double under = of.beside[i];
            d_exchanged[i] = std::abs(d_pivots[i]) < std::abs(under);
            if (d_exchanged[i]) {
                d_factors[i] = d_pivots[i] / under;
                d_pivots[i] = under;
                const double above = d_above[i];
                d_above[i] = d_pivots[i + 1];
                d_second[i] = d_above[i + 1];
                d_pivots[i + 1] = above - d_factors[i] * d_above[i];
                d_above[i + 1] = -d_factors[i] * d_second[i];
            } else {
                if (std::abs(d_pivots[i]) < least)
                    d_pivots[i] = least;
                d_factors[i] = under / d_pivots[i];
                d_pivots[i + 1] -= d_factors[i] * d_above[i];
            }
        }
        if (std::abs(d_pivots.back()) < least)
            d_pivots.back() = least;
    }

    void solve(values& x) const
    {
        const std::size_t count = d_pivots.size();
        for (std::size_t i = 0; i + 1 < count; i++) {
            if (d_exchanged[i])
                std::swap(x[i], x[i + 1]);
            x[i + 1] -= d_factors[i] * x[i];
        }
        for (std::size_t i = count; i-- > 0;) {
            if (i + 1 < count)
                x[i] -= d_above[i] * x[i + 1];
            if (i + 2 < count)
                x[i] -= d_second[i] * x[i + 2];
            x[i] /= d_pivots[i];
        }
    }

private:
    values d_pivots, d_above, d_second, d_factors;
    std::vector<char> d_exchanged;
};

void normalise(values& x)
{
    // In two steps, since what is divided by a tiny pivot may be too large to be squared.
    const double largest =
        std::abs(*std::max_element(x.begin(), x.end(), [](double a, double b) {
            return std::abs(a) < std::abs(b);
        }));
    for (double& value : x)
        value /= largest;
    const double norm = std::sqrt(std::inner_product(x.begin(), x.end(), x.begin(), 0.0));
    for (double& value : x)
        value /= norm;
}

} // namespace

values slepian_sequences(std::size_t length, double half_bandwidth, std::size_t order)
{
    tridiagonal matrix{ values(length), values(length - 1), 0.0 };
    const double cosine = std::cos(2 * pi * half_bandwidth / length);
    for (std::size_t n = 0; n < length; n++) {
        const double from_centre = (length - 1 - 2.0 * n) / 2;
        matrix.diagonal[n] = from_centre * from_centre * cosine;
        if (n)
            matrix.beside[n - 1] = n * (length - n) / 2.0;
    }
    for (std::size_t n = 0; n < length; n++) {
        const double row = std::abs(matrix.diagonal[n]) +
                           (n ? matrix.beside[n - 1] : 0.0) +
                           (n + 1 < length ? matrix.beside[n] : 0.0);
        matrix.norm = std::max(matrix.norm, row);
    }
    matrix.norm = std::max(matrix.norm, 1.0);
    values found;
    found.reserve(order * length);
    double upper = matrix.norm;
    for (std::size_t k = 0; k < order; k++) {
        upper = matrix.eigenvalue(length - 1 - k, upper);
        const shifted_solver solver(matrix, upper);
        values x(length);
        for (std::size_t n = 0; n < length; n++) // neither even nor odd
            x[n] = 1 + std::fmod(n * 0.6180339887498949, 1.0);
        for (int i = 0; i < iterations; i++) {
            solver.solve(x);
            normalise(x);
            for (auto other = found.begin(); other != found.end(); other += length) {
                const double along = std::inner_product(x.begin(), x.end(), other, 0.0);
                std::transform(
                    x.begin(), x.end(), other, x.begin(), [along](double a, double b) {
                        return a - along * b;
                    });
            }
            normalise(x);
        }
        found.insert(found.end(), x.begin(), x.end());
        upper += 2 * tolerance * matrix.norm;
    }
    return found;
}

} // namespace gr::wiforce::kernel
