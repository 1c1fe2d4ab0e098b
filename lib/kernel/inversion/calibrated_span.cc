// SPDX-License-Identifier: GPL-3.0-or-later
#include "calibrated_span.h"

#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

calibrated_span::calibrated_span(std::vector<double> location_mm,
                                 std::vector<double> low_n,
                                 std::vector<double> high_n)
    : d_location(std::move(location_mm)),
      d_low(std::move(low_n)),
      d_high(std::move(high_n))
{
    const auto size = d_location.size();
    require(size >= 2 && d_low.size() == size && d_high.size() == size,
            "calibrated_span",
            "location_mm",
            "must have 2 values or more, as many as low_n and high_n",
            size);
}

bool calibrated_span::extrapolated(double force_n,
                                   double location_mm,
                                   double force_variance,
                                   double location_variance) const
{
    if (contains(force_n, location_mm))
        return false;
    const double by_n = std::sqrt(force_variance), by_mm = std::sqrt(location_variance);
    for (const double along : { -by_mm, 0.0, by_mm })
        if (reaches(force_n - by_n, force_n + by_n, location_mm + along))
            return false;
    return true;
}

bool calibrated_span::reaches(double lowest_n, double highest_n, double location_mm) const
{
    if (!(location_mm >= d_location.front() && location_mm <= d_location.back()))
        return false;
    const auto next = std::clamp<std::ptrdiff_t>(
        std::upper_bound(d_location.begin(), d_location.end(), location_mm) -
            d_location.begin(),
        1,
        static_cast<std::ptrdiff_t>(d_location.size()) - 1);
    const double part =
        (location_mm - d_location[next - 1]) / (d_location[next] - d_location[next - 1]);
    const auto at = [&](const std::vector<double>& edge) {
        return edge[next - 1] + part * (edge[next] - edge[next - 1]);
    };
    return highest_n >= at(d_low) && lowest_n <= at(d_high);
}

} // namespace gr::wiforce::kernel
