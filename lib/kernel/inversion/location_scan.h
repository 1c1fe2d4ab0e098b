// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "tabulated_model.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * \brief Where along the line a press of given force explains the phases best, roughly.
 *
 * A press half a wavelength further shows the same phases modulo 360 deg: there may be
 * several such locations. They are the local minima of the phases' error on a grid that
 * is fine enough that no minimum lies between its nodes.
 */
class location_scan
{
public:
    static constexpr std::size_t most_found = 4;

    //! A phase (deg) modulo 360, in 2^-32 turns.
    static std::uint32_t counts(double phase_deg);

    //! The phases to be explained, in 2^-32 turns, and the variance of their noise
    //! (deg^2).
    struct target {
        std::uint32_t phase[tabulated_model::most_phases];
        float variance[tabulated_model::most_phases];
    };

    //! Scans the forces at these nodes of the table.
    location_scan(const tabulated_model& model, const std::vector<std::size_t>& forces);

    //! Largest distance (mm) of what is found from the minimum.
    double reach_mm() const { return d_reach_mm; }

    //! Locations (mm), rising, for the i-th force; gives their number, 1 or more.
    std::size_t find(std::size_t force, const target& wanted, double* found_mm) const;

private:
    void misfits(std::size_t force, const target& wanted, float* misfit) const;
    bool
    beyond_quarter_turn(std::size_t force, std::size_t node, const target& wanted) const;

    std::size_t d_phases;
    double d_reach_mm;
    std::vector<double> d_location;
    std::vector<std::uint32_t> d_phase; // forces x phases x locations, 2^-32 turns
    std::vector<float> d_slack;         // likewise: variance of what lies between nodes
};

} // namespace gr::wiforce::kernel
