// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace gr::wiforce::kernel {

// Up to this step of z a polynomial serves for the likelihood, to 1e-4 of it.
constexpr double small_step = 1.0;

// exp(-z^2 / 2) at `count` places, to 1e-9 of itself; in a form that compilers vectorise.
[[gnu::always_inline]] inline void
densities(const double* z, std::size_t count, double* density)
{
    constexpr double to_binary = -0.5 * 1.4426950408889634; // log2(e)
    constexpr double lowest = -1000.0;                      // exponent of 2
    for (std::size_t k = 0; k < count; k++) {
        const double exponent = std::max(to_binary * z[k] * z[k], lowest);
        const auto halvings = static_cast<std::int32_t>(0.5 - exponent);
        const double x = (exponent + halvings) * 0.6931471805599453; // ln 2
        // Taylor: |x| < 0.35
        double e = x * (1.0 / 40320) + 1.0 / 5040;
        e = e * x + 1.0 / 720;
        e = e * x + 1.0 / 120;
        e = e * x + 1.0 / 24;
        e = e * x + 1.0 / 6;
        e = e * x + 0.5;
        e = e * x + 1;
        e = e * x + 1;
        const auto bits = static_cast<std::uint64_t>(1023 - halvings) << 52;
        double power;
        std::memcpy(&power, &bits, sizeof power);
        density[k] = e * power;
    }
}

// The integral of exp(-z^2 / 2) from 0, by Taylor steps from a table: an error below
// 1e-9.
class normal_integral
{
public:
    normal_integral()
    {
        for (std::size_t i = 0; i < d_at.size(); i++) {
            const double z = static_cast<double>(i) / per_unit;
            d_at[i] = { std::exp(-0.5 * z * z),
                        std::sqrt(M_PI / 2) * std::erf(std::sqrt(0.5) * z) };
        }
    }

    double operator()(double z) const
    {
        const double x = std::min(std::abs(z), largest);
        const auto i = static_cast<std::size_t>(x * per_unit + 0.5);
        const double a = static_cast<double>(i) / per_unit, h = x - a;
        // derivatives of the density are Hermite polynomials times it
        const double second = (a * a - 1) / 6, third = a * (3 - a * a) / 24,
                     fourth = ((a * a - 6) * a * a + 3) / 120;
        const double mean = 1 + h * (-a / 2 + h * (second + h * (third + h * fourth)));
        return std::copysign(d_at[i].integral + h * d_at[i].density * mean, z);
    }

private:
    struct values {
        double density, integral;
    };

    static constexpr double largest = 40.0;
    static constexpr int per_unit = 32;
    std::vector<values> d_at = std::vector<values>(40 * per_unit + 1);
};

// Integrals of t^0, t^1, t^2 times exp(-z^2 / 2), z from a to b while t goes from 0 to 1.
struct integrals {
    double zeroth, first, second;
};

// By the polynomial of fifth degree that has the right values, slopes and bends at both
// ends; small steps.
inline integrals of_polynomial(double a, double b, double at_a, double at_b)
{
    const double step = b - a;
    const double rise_a = -a * step * at_a, rise_b = -b * step * at_b;
    const double bend_a = (a * a - 1) * step * step * at_a,
                 bend_b = (b * b - 1) * step * step * at_b;
    return {
        (60 * (at_a + at_b) + 12 * (rise_a - rise_b) + bend_a + bend_b) * (1.0 / 120),
        (120 * at_a + 300 * at_b + 32 * rise_a - 52 * rise_b + 3 * bend_a + 4 * bend_b) *
            (1.0 / 840),
        (100 * at_a + 460 * at_b + 30 * rise_a - 70 * rise_b + 3 * bend_a + 5 * bend_b) *
            (1.0 / 1680)
    };
}

// In closed form, given the integral of the density from a to b; large steps.
inline integrals by_parts(double a, double b, double at_a, double at_b, double between)
{
    const double per_step = 1 / (b - a), zeroth = between * per_step;
    const double first = ((at_a - at_b) * per_step - a * zeroth) * per_step;
    return { zeroth, first, ((zeroth - at_b) * per_step - a * first) * per_step };
}

} // namespace gr::wiforce::kernel
