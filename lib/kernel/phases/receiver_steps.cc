// SPDX-License-Identifier: GPL-3.0-or-later
#include "receiver_steps.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

namespace {

// Time over which the static path's own movement is averaged, in s, and how much a single
// group adds to it: a step must not hide the next one.
constexpr double memory_s = 1.0, most = 9.0;
// Variance of the static path of a converter, of 2 mdeg: of the receiver, no less.
constexpr double least = 1e-9;
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

receiver_steps::change receiver_steps::none() { return { 0.0, 0.0, least }; }

receiver_steps::change receiver_steps::next(const group& of)
{
    std::vector<complex> ratios(of.ratios, of.ratios + of.ends);
    for (std::size_t end = 0; end < of.ends; end++)
        if (!of.locked[end / 2])
            ratios[end] = std::numeric_limits<double>::quiet_NaN();
    double power = 0;
    for (std::size_t k = 0; k < of.subcarriers; k++)
        power += std::norm(of.static_path[k]);
    if (d_static.empty()) {
        d_static.assign(of.static_path, of.static_path + of.subcarriers);
        d_ratios = ratios;
        d_power = power;
    }
    complex product;
    for (std::size_t k = 0; k < of.subcarriers; k++)
        product += of.static_path[k] * std::conj(d_static[k]);
    // Presses change the tag's own part of the static path; unseen, to the opposite.
    double tag = 0;
    for (std::size_t end = 0; end < of.ends; end++) {
        const double changed = std::norm(ratios[end] - d_ratios[end]);
        tag += (std::isfinite(changed) ? changed : opposite) * of.reference_power[end];
    }
    tag *= duty * duty * double(of.subcarriers);
    const complex factor = product / d_power;
    const double turn = std::arg(factor), gain = std::log(std::abs(factor));
    // A path of another shape, as with another timing, says nothing of a common factor.
    const double own = (power + tag) / d_power - std::norm(factor);
    if (power != 0) {
        d_static.assign(of.static_path, of.static_path + of.subcarriers);
        d_ratios = std::move(ratios);
        d_power = power;
    }
    if (!std::isfinite(turn + gain + own))
        return none();
    // What the group itself explains says nothing of the groups that follow.
    const double square = std::max((turn * turn + gain * gain) / 2 - own, 0.0);
    if (std::isnan(d_variance))
        d_variance = std::max(own, least);
    const double variance = std::max({ d_variance, own, least });
    const double limit = most * std::max(d_variance, least);
    d_variance += d_share * (std::min(square, limit) - d_variance);
    return { turn, gain, variance };
}

} // namespace gr::wiforce::kernel
