// SPDX-License-Identifier: GPL-3.0-or-later
#include "noise_estimate.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

// Noise is averaged over two seconds, at least 32 groups: with M - 2S = 14 degrees of
// freedom per group the estimate on a subcarrier then has a standard deviation of 5 %,
// which costs 0.01 dB.
constexpr double memory_s = 2.0;
constexpr std::size_t least_memory_groups = 32;
// Smallest noise power relative to the mean tone. Tones in single precision have rounding
// errors of (6e-8)^2 = 3.6e-15.
constexpr double floor_of_level = 1e-14;
// Factor by which the median must have changed.
constexpr double step = 1.33;
// A transmitter on few subcarriers leaves the rest of them as they are: up to this lower
// quartile of the ratios, a group's noise may be raised on single subcarriers. Bursts,
// presses that change and errors of a clock raise it on all.
constexpr double narrow_band_quartile = 1.5;
// Standard deviations above which a subcarrier is raised: exceeded by noise in 1 of 10
// million. The limit grows with the cube of the quartile, since a residual with the
// profile of a fading tag (exponential powers, 14 times the quartile at most) is no
// narrow-band transmitter.
constexpr double raised_stds = 5.2;
// Least ratio that counts: less costs hardly anything. With an SNR above 20 dB, what
// edges of the tag spread over the subcarriers reaches 3 where it is not removed: in
// channels that another device measured.
constexpr double least_raised = 4.0;
// Groups in a row in which it is raised after which that is its usual noise. A
// transmitter that is on a subcarrier in four groups of ten hardly ever stays for as
// long.
constexpr int lasting_groups = 16;

double mean_of(const std::vector<double>& values)
{
    return std::accumulate(values.begin(), values.end(), 0.0) / values.size();
}

} // namespace

double chi_squared_limit(double freedom, double stds)
{
    return std::pow(1 - 1 / (9 * freedom) + stds / (3 * std::sqrt(freedom)), 3);
}

std::vector<double> raised_subcarriers(const std::vector<double>& ratios,
                                       std::size_t freedom)
{
    std::vector<double> raised(ratios.size(), 1.0);
    const double limit = std::max(chi_squared_limit(freedom, raised_stds), least_raised);
    if (!ratios.empty() && *std::max_element(ratios.begin(), ratios.end()) > limit) {
        auto sorted = ratios;
        const auto quarter = sorted.begin() + sorted.size() / 4;
        std::nth_element(sorted.begin(), quarter, sorted.end());
        const double quartile = std::max(1.0, *quarter);
        if (quartile <= narrow_band_quartile)
            for (std::size_t k = 0; k < ratios.size(); k++)
                if (ratios[k] > limit * std::pow(quartile, 3))
                    raised[k] = ratios[k];
    }
    return raised;
}

noise_estimate::noise_estimate(double group_period_s, std::vector<double> profile)
    : d_profile(std::move(profile)),
      d_memory(std::max<std::size_t>(least_memory_groups, memory_s / group_period_s))
{
}

double noise_estimate::level() const { return mean_of(d_variance); }

void noise_estimate::set(std::vector<double> variance,
                         double level,
                         std::optional<std::size_t> groups)
{
    known = true;
    d_groups = groups.value_or(d_groups);
    if (!d_profile.empty()) {
        double sum = 0;
        for (std::size_t k = 0; k < variance.size(); k++)
            sum += variance[k] / d_profile.at(k);
        for (std::size_t k = 0; k < variance.size(); k++)
            variance[k] = d_profile[k] * sum / variance.size();
    }
    const double least = std::max(floor_of_level * level, 1e-300);
    d_variance = std::move(variance);
    d_inverse.resize(d_variance.size());
    for (std::size_t k = 0; k < d_variance.size(); k++) {
        d_variance[k] = std::max(d_variance[k], least);
        d_inverse[k] = 1 / d_variance[k];
    }
}

noise_estimate::group noise_estimate::follow(std::vector<double> residual,
                                             std::size_t freedom,
                                             double level,
                                             bool complete)
{
    auto ratios = residual;
    for (std::size_t k = 0; k < ratios.size(); k++)
        ratios[k] *= d_inverse[k];
    group found{ 0, raised_subcarriers(ratios, freedom), d_inverse, verdict::learned };
    for (std::size_t k = 0; k < ratios.size(); k++) {
        found.inverse[k] /= found.raised[k];
        ratios[k] /= found.raised[k];
    }
    found.ratio = mean_of(ratios);
    if (complete)
        found.outcome = learn(std::move(residual), found, level);
    return found;
}

noise_estimate::verdict
noise_estimate::learn(std::vector<double> residual, const group& of, double level)
{
    d_raised_groups.resize(residual.size());
    // Raised subcarriers are learned only if it lasts.
    for (std::size_t k = 0; k < residual.size(); k++) {
        d_raised_groups[k] = of.raised[k] > 1 ? d_raised_groups[k] + 1 : 0;
        if (d_raised_groups[k] > 0 && d_raised_groups[k] <= lasting_groups)
            residual[k] = d_variance[k];
    }
    d_ratios.push_back(of.ratio);
    if (d_ratios.size() > step_groups)
        d_ratios.pop_front();
    const bool full = d_ratios.size() == step_groups;
    std::vector<double> sorted(d_ratios.begin(), d_ratios.end());
    std::sort(sorted.begin(), sorted.end());
    if (full && sorted.front() > outlier_ratio) {
        d_ratios.clear();
        return verdict::lost;
    }
    if (of.ratio > outlier_ratio)
        return verdict::learned;
    const double median = sorted[sorted.size() / 2];
    const bool stepped =
        full && !(1 / step < median && median < step) && median <= outlier_ratio;
    d_groups =
        stepped ? std::min(d_groups, step_groups) : std::min(d_groups + 1, d_memory);
    for (std::size_t k = 0; k < residual.size(); k++)
        if (stepped) // the profile over the subcarriers is still the best estimate
            residual[k] = median * d_variance[k];
        else
            residual[k] = d_variance[k] + (residual[k] - d_variance[k]) / d_groups;
    if (stepped)
        d_ratios.clear();
    set(std::move(residual), level);
    return stepped ? verdict::stepped : verdict::learned;
}

} // namespace gr::wiforce::kernel
