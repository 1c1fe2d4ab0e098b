// SPDX-License-Identifier: GPL-3.0-or-later
#include "clock_tracker.h"

#include <algorithm>
#include <cmath>

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

clock_tracker::clock_tracker(const fit& start)
    : time_s(start.time_s),
      phase(start.phase),
      rate(start.rate),
      variances{ start.phase_variance, 0.0, start.rate_variance },
      seen_s(start.seen_s),
      d_nominal(start.nominal_rate),
      d_subcarriers(start.subcarriers),
      d_slope_variance(start.slope_variance),
      d_drift_power(std::pow(drift_per_s * start.nominal_rate, 2) * drift_memory_s),
      d_energy(start.energy),
      d_curvature(start.curvature),
      d_groups(std::min(start.groups, curvature_memory))
{
}

void clock_tracker::advance(double at_s)
{
    const double dt = at_s - time_s, q = d_drift_power;
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
bool clock_tracker::is_present(double energy, double expected) const
{
    const double excess = energy - 2 * d_subcarriers;
    expected -= 2 * d_subcarriers;
    const double spread = 3 * std::sqrt(2 * d_subcarriers + 2 * std::max(expected, 0.0));
    return excess > std::min(presence * expected, expected - spread);
}

bool clock_tracker::update(double at_s,
                           const double* likelihood,
                           double noise_level,
                           const measurement* measured)
{
    advance(at_s);
    const double energy = likelihood[0], slope = likelihood[1], curvature = likelihood[2];
    if (!is_present(energy, d_energy / noise_level))
        return false;
    d_groups = std::min(d_groups + 1, curvature_memory);
    d_energy += (noise_level * energy - d_energy) / d_groups;
    d_curvature += (noise_level * curvature - d_curvature) / d_groups;
    const double kappa = std::max(-d_curvature / noise_level, 1e-9);
    const auto found =
        measured
            ? *measured
            : measurement{ slope / kappa, (kappa + d_slope_variance) / (kappa * kappa) };
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
