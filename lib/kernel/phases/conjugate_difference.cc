// SPDX-License-Identifier: GPL-3.0-or-later
#include "conjugate_difference.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

namespace {

using complex = std::complex<double>;

// An end is flagged when more than 20 % of its energy plus three times its noise do not
// have the reference's profile over the subcarriers (docs/data/thresholds.csv).
constexpr double reshaped_share = 0.2, reshaped_noise = 3.0;
// Smallest share of the reference's power that is left when its noise is subtracted: R
// stays finite where the reference is mostly noise.
constexpr double least_power = 0.05;
constexpr double degrees = 180 / M_PI;

// a conj(b), without the special cases of infinite values.
complex times_conj(complex a, complex b)
{
    return { a.real() * b.real() + a.imag() * b.imag(),
             a.imag() * b.real() - a.real() * b.imag() };
}

double finite(double value) { return std::isfinite(value) ? value : 0.0; }

// Maximum-ratio weights 1 / sigma_k^2, scaled to sum to 1.
std::vector<double> weights_of(const double* noise, std::size_t subcarriers)
{
    std::vector<double> weights(subcarriers);
    double sum = 0;
    for (std::size_t k = 0; k < subcarriers; k++)
        sum += weights[k] = 1 / noise[k];
    for (double& weight : weights)
        weight /= sum;
    return weights;
}

} // namespace

difference conjugate_difference(const end_channels& ends,
                                const reference_channels& reference,
                                std::size_t end_count,
                                std::size_t subcarriers,
                                profile_check* check)
{
    difference found{ { ends.gain, ends.gain + end_count },
                      std::vector<double>(end_count),
                      std::vector<char>(end_count) };
    const auto weights = weights_of(ends.noise, subcarriers);
    double mean_noise = 0;
    for (std::size_t k = 0; k < subcarriers; k++)
        mean_noise += weights[k] * ends.noise[k];
    if (check) {
        std::vector<double> both(end_count);
        for (std::size_t end = 0; end < end_count; end++)
            both[end] = ends.gain[end] + reference.gain[end];
        const auto factors = check->process(
            ends.values, { weights.data(), ends.noise, ends.noise_rise, both.data() });
        for (std::size_t end = 0; end < end_count; end++)
            found.gain[end] *= factors[end];
    }
    for (std::size_t end = 0; end < end_count; end++) {
        complex* const channel = ends.values + end * subcarriers;
        const complex* const before = reference.values + end * subcarriers;
        double power = 0, energy = 0;
        for (std::size_t k = 0; k < subcarriers; k++) {
            power += weights[k] * std::norm(before[k]);
            energy += weights[k] * std::norm(channel[k]);
        }
        // Noise in the reference adds to its power and would bias |R| towards 0.
        if (std::isfinite(reference.gain[end]))
            power =
                std::max(power - reference.gain[end] * mean_noise, least_power * power);
        else
            power = 0;
        const double scale = power > 0 ? 1 / power : 0;
        complex mean;
        for (std::size_t k = 0; k < subcarriers; k++) {
            channel[k] = scale * times_conj(channel[k], before[k]);
            mean += weights[k] * channel[k];
        }
        // A press rotates all subcarriers equally. The residual V - R V_ref is noise,
        // unless the tag was moved or the frame timing has shifted.
        const double explained = std::norm(mean) * power;
        found.power[end] = power;
        found.reshaped[end] = energy - explained >
                              reshaped_share * energy +
                                  reshaped_noise * finite(found.gain[end]) * mean_noise;
    }
    return found;
}

ratio subcarrier_average(const complex* changes,
                         const double* noise,
                         std::size_t subcarriers,
                         double gain,
                         double reference_gain,
                         double reference_power)
{
    double precision = 0;
    complex sum;
    for (std::size_t k = 0; k < subcarriers; k++) {
        precision += 1 / noise[k];
        sum += changes[k] / noise[k];
    }
    const complex mean = sum / precision;
    const double energy = reference_power * precision, size = std::abs(mean);
    double std = std::numeric_limits<double>::infinity();
    if (energy > 0 && size > 0) {
        const double rise = 1 + reference_gain * double(subcarriers) / energy;
        // Half of the noise lies along the phase.
        std = degrees * std::sqrt(gain * rise / energy / 2) / size;
    }
    return { mean, std };
}

} // namespace gr::wiforce::kernel
