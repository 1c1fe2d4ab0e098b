// SPDX-License-Identifier: GPL-3.0-or-later
#include "coherent_residual.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

namespace {

// Standard deviations above which a group's own ratio, or the median, is more than noise.
// With 22 degrees of freedom, five are exceeded by 1 group in 10 000.
constexpr double group_stds = 5.0, lasting_stds = 4.0;
// Groups of the median. Bursts and presses that change disturb fewer than half of them.
constexpr std::size_t median_groups = 48;
// Factor above which what is received is not this tag and noise: a second tag on nearly
// the same clock hides most of itself in the ends. Rooms whose disturbances lie
// beside the lines reach 36, such tags 47 and more (SNR 10 dB, tests/rooms).
constexpr double is_disturbed = 42.0;
// The sandwich estimate has about a third of the degrees of freedom.
constexpr double freedom_share = 3.0;

} // namespace

std::pair<double, std::size_t> coherent_residual::running_median::update(double value)
{
    d_latest.push_back(value);
    if (std::isfinite(value))
        d_sorted.insert(std::upper_bound(d_sorted.begin(), d_sorted.end(), value), value);
    if (d_latest.size() > median_groups) {
        const double oldest = d_latest.front();
        d_latest.pop_front();
        if (std::isfinite(oldest))
            d_sorted.erase(std::lower_bound(d_sorted.begin(), d_sorted.end(), oldest));
    }
    const std::size_t count = d_sorted.size();
    if (!count)
        return { std::numeric_limits<double>::infinity(), 0 };
    return { (d_sorted[(count - 1) / 2] + d_sorted[count / 2]) / 2, count };
}

void coherent_residual::reset()
{
    std::fill(d_medians.begin(), d_medians.end(), running_median{});
}

coherent_residual::result coherent_residual::update(const end_fit& fit,
                                                    const std::vector<std::size_t>& rows,
                                                    const double* inverse_noise)
{
    const auto ratios = fit.coherent(inverse_noise);
    const double freedom = fit.freedom(), spread = 1 / std::sqrt(freedom);
    result found{ std::vector<double>(ratios.mean.size()),
                  std::vector<char>(ratios.mean.size()) };
    for (std::size_t i = 0; i < ratios.mean.size(); i++) {
        double& factor = found.factor[i];
        const double own = ratios.mean[i];
        factor = own > 1 + group_stds * spread ? own : 1;
        auto [lasting, count] =
            d_medians.at(rows[i % rows.size()]).update(ratios.sandwich[i]);
        // The median of a gamma distribution lies below its mean.
        lasting /= 1 - freedom_share / (3 * freedom);
        if (lasting > 1 + lasting_stds * spread * std::sqrt(freedom_share / count))
            factor = std::max(factor, lasting);
        // The mean of all tones underestimates what the change of another tag leaves near
        // the lines of this one.
        double near = lasting;
        if (own > (1 + group_stds * spread) * std::max(lasting, 1.0)) {
            near = std::max(near, ratios.sandwich[i]);
            factor = std::max(factor, near);
        }
        found.disturbed[i] = near > is_disturbed;
    }
    return found;
}

} // namespace gr::wiforce::kernel
