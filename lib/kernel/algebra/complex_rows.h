// SPDX-License-Identifier: GPL-3.0-or-later
// Sums over rows of complex numbers, written in real ones, which compilers vectorise.
#pragma once

#include <complex>
#include <cstddef>
#include <cstring>

namespace gr::wiforce::kernel {

// sum += factor x row
inline void add_scaled(std::complex<double> factor,
                       const std::complex<double>* row,
                       std::size_t count,
                       std::complex<double>* sum)
{
    const double real = factor.real(), imag = factor.imag();
    const auto* const from = reinterpret_cast<const double*>(row);
    auto* const to = reinterpret_cast<double*>(sum);
    for (std::size_t i = 0; i < 2 * count; i += 2) {
        const double x = from[i], y = from[i + 1];
        to[i] += real * x - imag * y;
        to[i + 1] += real * y + imag * x;
    }
}

// Sum of |row|^2, in sums that do not wait for each other.
inline __attribute__((always_inline)) double power_of(const std::complex<double>* row,
                                                      std::size_t count)
{
    using four = double __attribute__((vector_size(32)));
    const auto* const values = reinterpret_cast<const double*>(row);
    four sums[4]{};
    std::size_t i = 0;
    for (; i + 16 <= 2 * count; i += 16)
        for (std::size_t j = 0; j < 4; j++) {
            four next;
            std::memcpy(&next, values + i + 4 * j, sizeof next);
            sums[j] += next * next;
        }
    const four all = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    double sum = (all[0] + all[1]) + (all[2] + all[3]);
    for (; i < 2 * count; i++)
        sum += values[i] * values[i];
    return sum;
}

// Real part of conj(first) x second.
inline double real_product(std::complex<double> first, std::complex<double> second)
{
    return first.real() * second.real() + first.imag() * second.imag();
}

// sum += |row|^2
inline void add_powers(const std::complex<double>* row, std::size_t count, double* sum)
{
    const auto* const values = reinterpret_cast<const double*>(row);
    for (std::size_t i = 0; i < count; i++)
        sum[i] += values[2 * i] * values[2 * i] + values[2 * i + 1] * values[2 * i + 1];
}

} // namespace gr::wiforce::kernel
