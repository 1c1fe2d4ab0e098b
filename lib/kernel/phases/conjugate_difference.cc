// SPDX-License-Identifier: GPL-3.0-or-later
#include "conjugate_difference.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// An end is flagged when more than 20 % of its energy plus three times its noise do not
// have the reference's profile over the subcarriers (docs/data/thresholds.csv).
constexpr double reshaped_share = 0.2, reshaped_noise = 3.0;
// Smallest share of the reference's power that is left when its noise is subtracted: R
// stays finite where the reference is mostly noise.
constexpr double least_power = 0.05;
// An image whose profile is this similar to the channel itself (squared correlation) is
// not separable from it.
constexpr double similar_profile = 0.25;
// An image is removed as far as its power exceeds this many times that of noise (James
// and Stein, 1961), and corrected to second order from the higher one on.
constexpr double shrinkage = 2.0, significant_image = 25.0;
// Standard deviations by which residual power must exceed that of noise: in a single
// group, and in the mean of the last groups.
constexpr double group_stds = 5.0, mean_stds = 4.0;
constexpr std::size_t mean_groups = 8;

// a conj(b), without the special cases of infinite values.
complex times_conj(complex a, complex b)
{
    return { a.real() * b.real() + a.imag() * b.imag(),
             a.imag() * b.real() - a.real() * b.imag() };
}

complex times(complex a, complex b)
{
    return { a.real() * b.real() - a.imag() * b.imag(),
             a.imag() * b.real() + a.real() * b.imag() };
}

bool is_finite(complex value)
{
    return std::isfinite(value.real()) && std::isfinite(value.imag());
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

profile_check::profile_check(std::size_t ends, std::size_t subcarriers)
    : d_subcarriers(subcarriers), d_residual(subcarriers), d_means(ends)
{
}

void profile_check::set_reference(channel reference, channel image, channel other)
{
    d_reference = std::move(reference);
    d_image = std::move(image);
    d_other = std::move(other);
    d_other_powers.resize(d_other.size());
    std::transform(d_other.begin(),
                   d_other.end(),
                   d_other_powers.begin(),
                   [](complex value) { return std::norm(value); });
}

void profile_check::reset() { std::fill(d_means.begin(), d_means.end(), mean{}); }

double profile_check::process(std::size_t end,
                              complex* channel,
                              const double* weights,
                              const end_channels& by,
                              double gain)
{
    const complex* const reference = d_reference.data() + end * d_subcarriers;
    const complex* const image = d_image.data() + end * d_subcarriers;
    // Along the reference and its image.
    double power = 0, image_power = 0, mean_noise = 0;
    complex overlap, along, along_image;
    for (std::size_t k = 0; k < d_subcarriers; k++) {
        const double weight = weights[k];
        power += weight * std::norm(reference[k]);
        image_power += weight * std::norm(image[k]);
        mean_noise += weight * weight * by.noise[k];
        overlap += weight * times_conj(image[k], reference[k]);
        along += weight * times_conj(channel[k], reference[k]);
        along_image += weight * times_conj(channel[k], image[k]);
    }
    const complex similar = overlap / power;
    // Power of the image without what is similar to the reference, and the level of that.
    const double own_power = image_power - std::norm(similar) * power;
    complex level = (along_image - times_conj(along, similar)) / own_power;
    const double level_noise = gain * mean_noise / own_power;
    const double level_power = std::norm(level);
    // Where there is no image, removing the noise along its profile would only add noise.
    const double kept = 1 - shrinkage * level_noise / level_power;
    level *= kept < 0 ? 0.0 : kept;
    const bool separable = own_power > (1 - similar_profile) * power && is_finite(level);
    if (!separable)
        level = 0;
    complex ratio = along / power - times(level, similar);
    // The reference holds an image of its own: to second order R = a + conj(nu) b for
    // levels a of the reference and b = nu (conj(R) - R) of the image.
    complex second;
    if (separable && level_power > significant_image * level_noise &&
        level_power < 0.1 * std::abs(ratio.imag()))
        second = { 0, -level_power / (2 * ratio.imag()) };
    ratio = is_finite(ratio) ? ratio + second : second;
    for (std::size_t k = 0; k < d_subcarriers; k++) {
        channel[k] += times(second, reference[k]) - times(level, image[k]);
        d_residual[k] = channel[k] - times(ratio, reference[k]);
        if (by.noise_rise)
            d_residual[k] /= std::sqrt(by.noise_rise[k]);
    }
    const std::size_t size = end * d_other.size() / ends();
    const std::size_t profiles = d_other.size() / ends() / d_subcarriers;
    double other_ratio = 0;
    for (std::size_t profile = 0; profile < profiles; profile++) {
        const std::size_t first = size + profile * d_subcarriers;
        complex other;
        double noise = 0;
        for (std::size_t k = 0; k < d_subcarriers; k++) {
            other += times(d_residual[k], d_other[first + k]);
            noise += by.noise[k] / (by.noise_rise ? by.noise_rise[k] : 1.0) *
                     d_other_powers[first + k];
        }
        other_ratio += std::norm(other) / noise;
    }
    const double cost = level != 0.0 ? power / own_power : 1.0;
    return cost * factor(end, other_ratio / (profiles * gain));
}

// Factor of an end by its power on other profiles over the noise, where that is more.
double profile_check::factor(std::size_t end, double ratio)
{
    auto& mean = d_means[end];
    const bool known = std::isfinite(ratio);
    if (known) {
        mean.groups++;
        const double count = std::min(mean.groups, mean_groups);
        mean.ratio +=
            (std::min(ratio, 4 * std::max(mean.ratio, 1.0)) - mean.ratio) / count;
    }
    const double profiles = d_other.size() / ends() / d_subcarriers;
    const double spread = 1 / std::sqrt(profiles);
    const double count = std::clamp<std::size_t>(mean.groups, 1, mean_groups);
    double factor =
        mean.ratio > 1 + mean_stds * spread / std::sqrt(count) ? mean.ratio : 1.0;
    if (known && ratio > 1 + group_stds * spread)
        factor = std::max(factor, ratio);
    return factor;
}

void conjugate_difference(const end_channels& ends,
                          const reference_channels& reference,
                          std::size_t end_count,
                          std::size_t subcarriers,
                          profile_check* check,
                          const difference& found)
{
    const auto weights = weights_of(ends.noise, subcarriers);
    double mean_noise = 0;
    for (std::size_t k = 0; k < subcarriers; k++)
        mean_noise += weights[k] * ends.noise[k];
    for (std::size_t end = 0; end < end_count; end++) {
        complex* const channel = ends.values + end * subcarriers;
        const complex* const before = reference.values + end * subcarriers;
        found.gain[end] = ends.gain[end];
        if (check)
            found.gain[end] *= check->process(
                end, channel, weights.data(), ends, ends.gain[end] + reference.gain[end]);
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
}

} // namespace gr::wiforce::kernel
