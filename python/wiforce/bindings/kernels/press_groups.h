// SPDX-License-Identifier: GPL-3.0-or-later
// What the stages before the press filter say of a sensor's groups.
#pragma once

#include "kernels.h"

#include <array>
#include <cstdint>

// A group of a sensor, as far as it is known before the filter has taken it.
struct sensor_group {
    std::int64_t group; // index on the grid of the run
    std::int64_t flags;
    double snr_db;          // of the weaker end
    double interference;    // share of the snapshots that were left out
    double common_variance; // of a rotation in this group alone, rad^2
    bool readable, overlapping, disturbed;
};

// What does not depend on the group.
struct sensor_settings {
    double period_s; // of groups
    // Flags: reference, gap, saturated, moved, inconsistent.
    std::array<std::int64_t, 5> bits;
    double claimed;      // probability that the sensor is untouched in its reference
    double least_snr_db; // below which something is received on the tag's own lines
    bool in_lamps;       // whether it is in any case
};

// Observations for the filter, whose phases are NaN where a group cannot be read, and
// `sensor_group`, (G,) each. `groups` has the arrays of `estimation.groups.Groups`;
// `receiver` (G, 3) is as `receiver_steps` gives it.
pybind11::tuple groups_of_sensor(const sensor_settings& by,
                                 const pybind11::dict& groups,
                                 pybind11::ssize_t sensor,
                                 const array<double>& receiver);
