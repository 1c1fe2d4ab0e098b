// SPDX-License-Identifier: GPL-3.0-or-later
#include "clock_tracker.h"

#include "../clones.h"
#include "../require.h"
#include "matrix_product.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace gr::wiforce::kernel {

namespace {

constexpr double turn = 6.283185307179586476925;
// The drift of up to 0.5 ppm/s is modelled as a random walk of the rate that reaches it
// in 1 s.
constexpr double drift_per_s = 0.5e-6, drift_memory_s = 1.0;
// Groups that energy and curvature of J are averaged over, and the largest correction of
// the phase in rad: half a period of J's highest term, 2 pi / 16.
constexpr std::size_t curvature_memory = 24;
constexpr double largest_step = 0.2;
// Standard deviations above which an error is a jump of the phase, which does not change
// the rate.
constexpr double jump_stds = 6.0;
// A group with less than this share of the expected excess energy does not contain the
// tag. A press changes the amplitude of a tag with an off reflection of 0.3 rho from 1.3
// to 0.7 rho, its energy by a factor of 0.29.
constexpr double presence = 0.1;

} // namespace

clock_likelihood::clock_likelihood(std::vector<complex> derivatives,
                                   std::vector<double> lines)
    : d_derivatives(std::move(derivatives)), d_lines(std::move(lines))
{
    require(d_derivatives.size() == 6 * d_lines.size(),
            "clock_likelihood: derivatives must have shape (6, " +
                std::to_string(d_lines.size()) + ")",
            std::to_string(d_derivatives.size()) + " values");
}

WIFORCE_CLONES
std::array<double, 3> clock_likelihood::at(double phase,
                                           const complex* tones,
                                           const double* inverse_noise,
                                           std::size_t subcarriers) const
{
    const std::size_t lines = d_lines.size(), rows = 6; // of u, u' and u'', two each
    // Products with the real and, behind them, with the imaginary parts.
    std::vector<double> turned(2 * rows * lines);
    for (std::size_t line = 0; line < lines; line++) {
        const complex turn = std::polar(1.0, -d_lines[line] * phase);
        for (std::size_t row = 0; row < rows; row++) {
            const complex value = d_derivatives[row * lines + line] * turn;
            turned[row * lines + line] = value.real();
            turned[(rows + row) * lines + line] = value.imag();
        }
    }
    std::vector<complex> sums(2 * rows * subcarriers);
    add_product({ turned.data(), 2 * rows, lines }, tones, subcarriers, sums.data());
    for (std::size_t i = 0; i < rows * subcarriers; i++) {
        const complex by_imag = sums[rows * subcarriers + i];
        sums[i] += complex{ -by_imag.imag(), by_imag.real() };
    }
    std::array<double, 3> found{};
    for (const std::size_t first : { std::size_t(0), subcarriers }) // elements of u
        for (std::size_t k = 0; k < subcarriers; k++) {
            const complex *const at = &sums[first + k], value = at[0],
                                 slope = at[2 * subcarriers],
                                 curvature = at[4 * subcarriers];
            found[0] += real_product(value, value) * inverse_noise[k];
            found[1] += 2 * real_product(value, slope) * inverse_noise[k];
            found[2] += 2 *
                        (real_product(value, curvature) + real_product(slope, slope)) *
                        inverse_noise[k];
        }
    return found;
}

void clock_tracker::advance(double at_s)
{
    const double dt = at_s - time_s,
                 q = std::pow(drift_per_s * nominal_rate, 2) * drift_memory_s;
    phase = std::fmod(predict(at_s), turn);
    if (phase < 0)
        phase += turn;
    const auto [p00, p01, p11] = variances;
    variances = { p00 + 2 * dt * p01 + dt * dt * p11 + q * dt * dt * dt / 3,
                  p01 + dt * p11 + q * dt * dt / 2,
                  p11 + q * dt };
    time_s = at_s;
}

// Whether the energy above that of noise, 2 per subcarrier, is about as expected.
bool clock_tracker::shown_by(const std::array<double, 3>& likelihood,
                             double noise_level) const
{
    const double excess = likelihood[0] - 2 * subcarriers,
                 expected = energy / noise_level - 2 * subcarriers;
    const double spread = 3 * std::sqrt(2 * subcarriers + 2 * std::max(expected, 0.0));
    return excess > std::min(presence * expected, expected - spread);
}

bool clock_tracker::update(double at_s,
                           const std::array<double, 3>& likelihood,
                           double noise_level,
                           const measurement* measured)
{
    advance(at_s);
    const auto [here, slope, bend] = likelihood;
    if (!shown_by(likelihood, noise_level))
        return false;
    groups = std::min(groups + 1, curvature_memory);
    energy += (noise_level * here - energy) / groups;
    curvature += (noise_level * bend - curvature) / groups;
    const double kappa = std::max(-curvature / noise_level, 1e-9);
    const auto found =
        measured
            ? *measured
            : measurement{ slope / kappa, (kappa + slope_variance) / (kappa * kappa) };
    const auto [p00, p01, p11] = variances;
    const double spread = p00 + found.variance;
    const double error = std::clamp(found.error, -largest_step, largest_step);
    phase += p00 / spread * error;
    if (found.error * found.error <= jump_stds * jump_stds * spread) {
        const double gain = p01 / spread;
        rate += gain * error;
        variances = { p00 - p00 / spread * p00,
                      p01 - p00 / spread * p01,
                      p11 - gain * p01 };
    }
    seen_s = at_s;
    return true;
}

} // namespace gr::wiforce::kernel
