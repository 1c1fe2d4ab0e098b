// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"
#include "press_observation.h"

#include <array>
#include <cstddef>
#include <cstdint>

namespace gr::wiforce::kernel {

// A group of a sensor, as far as it is known before the press filter has taken it.
struct sensor_group {
    std::int64_t group; // index on the grid of the run
    std::int64_t flags;
    double snr_db;          // of the weaker end
    double interference;    // share of the snapshots that were left out
    double common_variance; // of a rotation in this group alone, rad^2
    bool readable, overlapping, disturbed;
};

// What the stages before the press filter say of the groups of a batch: arrays of
// `estimation.groups.Groups`.
struct stage_arrays {
    std::size_t groups, sensors;
    const complex* ratios;                // G x 2S
    const double *phase_std_deg, *snr_db; // G x 2S, the latter null where it is unknown
    const bool *in_reference, *late_reference, *reshaped; // G x 2S
    const bool *locked, *overlapping, *disturbed;         // G x S, the last may be null
    const std::int64_t *index, *missing;                  // G
    const bool *saturated, *retuned, *in_tare;            // G
    const double *common_std_deg, *interference;          // G
};

// Parts the arrays of a batch into the groups of a sensor.
struct sensor_groups {
    double period_s; // of groups
    // Flags: reference, gap, saturated, moved, inconsistent.
    std::array<std::int64_t, 5> bits;
    double claimed;      // probability that the sensor is untouched in its reference
    double least_snr_db; // below which something is received on the tag's own lines
    bool in_lamps;       // whether it is in any case

    // `receiver` (G x 3) is as `receiver_steps` gives it. Phases of `seen` are NaN where
    // a group cannot be read.
    void of(const stage_arrays& arrays,
            std::size_t sensor,
            const double* receiver,
            press_observation* seen,
            sensor_group* known) const;
};

} // namespace gr::wiforce::kernel
