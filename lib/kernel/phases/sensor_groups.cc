// SPDX-License-Identifier: GPL-3.0-or-later
#include "sensor_groups.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

namespace {

// R of an end that was not received is 0, and has no logarithm.
constexpr double least_ratio = std::numeric_limits<double>::min();
constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

double squared_rad(double degrees)
{
    const double rad = degrees * (M_PI / 180);
    return rad * rad;
}

} // namespace

void sensor_groups::of(const stage_arrays& arrays,
                       std::size_t sensor,
                       const double* receiver,
                       press_observation* seen,
                       sensor_group* known) const
{
    for (std::size_t row = 0; row < arrays.groups; row++, receiver += 3) {
        const std::size_t tag = row * arrays.sensors + sensor, end = 2 * tag;
        const auto either = [end](const bool* of) { return of[end] || of[end + 1]; };
        press_observation& group = seen[row] = {};
        sensor_group& of = known[row];
        of.group = arrays.index[row];
        of.interference = arrays.interference[row];
        of.common_variance = squared_rad(arrays.common_std_deg[row]);
        of.overlapping = arrays.overlapping[tag];
        of.readable = arrays.locked[tag] && !of.overlapping;
        of.snr_db = unknown;
        if (arrays.snr_db) {
            const double *const snr = arrays.snr_db + end, sum = snr[0] + snr[1];
            of.snr_db = std::isnan(sum) ? sum : std::min(snr[0], snr[1]);
        }
        of.disturbed = in_lamps || (arrays.disturbed && arrays.disturbed[tag]) ||
                       of.snr_db < least_snr_db;
        const bool late = either(arrays.late_reference);
        const bool learns = either(arrays.in_reference);
        const bool raised[] = { learns || arrays.in_tare[row],
                                arrays.missing[row] > 0,
                                arrays.saturated[row],
                                either(arrays.reshaped),
                                of.overlapping || late };
        of.flags = 0;
        for (std::size_t i = 0; i < bits.size(); i++)
            of.flags |= raised[i] ? bits[i] : 0;
        group.time_s = (of.group + 0.5) * period_s;
        for (int e = 0; e < 2; e++) {
            const auto ratio = arrays.ratios[end + e];
            group.phase[e] = std::arg(ratio);
            group.amplitude[e] = std::log(std::max(std::abs(ratio), least_ratio));
            group.variance[e] = squared_rad(arrays.phase_std_deg[end + e]);
            of.readable &= ratio != 0.0 && std::isfinite(group.amplitude[e]) &&
                           std::isfinite(group.variance[e]);
        }
        group.common_variance = of.common_variance;
        group.receiver_phase = receiver[0];
        group.receiver_amplitude = receiver[1];
        group.receiver_variance = receiver[2];
        group.retuned = arrays.retuned[row];
        group.untouched = learns && !late ? claimed : 0.0;
        if (!of.readable)
            group.phase.fill(unknown);
    }
}

} // namespace gr::wiforce::kernel
