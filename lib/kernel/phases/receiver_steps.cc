// SPDX-License-Identifier: GPL-3.0-or-later
#include "receiver_steps.h"
#include "press_observation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// Time over which the static path's own movement is averaged, in s, and how much a single
// group adds to it: a step must not hide the next one.
constexpr double memory_s = 1.0, most = 9.0;
// Part of the time for which an end is switched on: so much of it is in a group's mean.
constexpr double duty = 0.25;
// |R - R'|^2 of an end that turns to the opposite, where it is not seen.
constexpr double opposite = 4.0;

} // namespace

receiver_steps::receiver_steps(double group_period_s)
    : d_share(std::min(1.0, group_period_s / memory_s)),
      d_variance(std::numeric_limits<double>::quiet_NaN())
{
}

receiver_steps::change receiver_steps::none()
{
    return { 0.0, 0.0, least_receiver_variance };
}

receiver_steps::change receiver_steps::next(const group& of)
{
    std::vector<complex> ratios(of.ratios, of.ratios + of.ends);
    for (std::size_t end = 0; end < of.ends; end++)
        if (!of.locked[end / 2])
            ratios[end] = std::numeric_limits<double>::quiet_NaN();
    auto now = path_of(of);
    if (d_static.path.empty()) {
        d_static = d_before = now;
        d_ratios = ratios;
    }
    const auto common = now.over(d_static), lasting = now.over(d_before);
    const double before = std::exchange(d_before, now).power;
    // Presses change the tag's own part of the static path; unseen, to the opposite.
    double tag = 0;
    for (std::size_t end = 0; end < of.ends; end++) {
        const double changed = std::norm(ratios[end] - d_ratios[end]);
        tag += (std::isfinite(changed) ? changed : opposite) * of.reference_power[end];
    }
    tag *= duty * duty * double(of.subcarriers);
    // What is left of this path, over the part that is the former one.
    const double part = std::norm(common) * d_static.power;
    const double own = (now.power + tag) / part - 1;
    const bool same = part > now.power / 2,
               lasts = std::norm(lasting) * before > now.power / 2;
    if (same || lasts) {
        d_static = std::move(now);
        d_ratios = std::move(ratios);
    }
    if (!std::isfinite(own))
        return none();
    const double least_own = std::max(own, least_receiver_variance);
    // Noise, where nothing is sent, and a path of another shape, as with another timing,
    // say nothing of a common factor.
    if (!same)
        return { 0.0, 0.0, least_own };
    const double turn = std::arg(common), gain = std::log(std::abs(common));
    // What the group itself explains says nothing of the groups that follow.
    const double square = std::max((turn * turn + gain * gain) / 2 - own, 0.0);
    if (std::isnan(d_variance))
        d_variance = least_own;
    const double variance = std::max(d_variance, least_own);
    const double limit = most * std::max(d_variance, least_receiver_variance);
    d_variance += d_share * (std::min(square, limit) - d_variance);
    return { turn, gain, variance };
}

receiver_steps::static_path receiver_steps::path_of(const group& of)
{
    static_path found{ { of.static_path, of.static_path + of.subcarriers } };
    for (const auto& each : found.path)
        found.power += std::norm(each);
    return found;
}

complex receiver_steps::static_path::over(const static_path& other) const
{
    complex product;
    for (std::size_t k = 0; k < path.size(); k++)
        product += path[k] * std::conj(other.path[k]);
    return product / other.power;
}

} // namespace gr::wiforce::kernel
