// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "press_fit.h"

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

    //! The phases to be explained, in 2^-32 turns, the variance of their noise (deg^2),
    //! and what one standard deviation of an error that all share adds to each (deg).
    struct target {
        std::uint32_t phase[tabulated_model::most_phases];
        float variance[tabulated_model::most_phases],
            shared[tabulated_model::most_phases];
    };

    //! Scans the forces at these nodes of the table.
    location_scan(const tabulated_model& model, const std::vector<std::size_t>& forces);

    //! Largest distance (mm) of what is found from the minimum.
    double reach_mm() const { return d_reach_mm; }

    //! Locations (mm), rising, for the i-th force; gives their number, 1 or more.
    //! `misfit` is used again to save the time for its memory.
    std::size_t find(std::size_t force,
                     const target& wanted,
                     std::vector<float>& misfit,
                     double* found_mm) const;

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

/*!
 * \brief The profile likelihood of a press over its force.
 *
 * For every force, the location that explains the phases best. The residual that it
 * leaves, in standard deviations, is taken as linear from one force to the next. Forces
 * are taken closely enough for that wherever the likelihood is not negligible.
 */
class likelihood_profile
{
public:
    //! From one point to the next: the squared residual is rest + z^2 with z linear.
    struct segment {
        std::size_t point;  //!< where it begins; it ends at the next
        std::size_t branch; //!< with gaps where the likelihood is negligible
        double z_from, z_to, rest;
        double misfit; //!< least squared residual
    };

    struct curve {
        std::vector<press_fit::point> points;
        std::vector<segment> segments; //!< those whose likelihood is not negligible
        double inflation;              //!< of the variances, see draw()
    };

    //! A least squared residual of up to `consistent` is that of a press.
    likelihood_profile(tabulated_model model, double consistent);

    const press_fit& fit() const { return d_fit; }
    double consistent() const { return d_consistent; }

    /*!
     * Draws the profile; `out` may be used again to save the time for its memory.
     *
     * Where no press explains the phases, their errors are larger than was said. The
     * variances are inflated by the Birge ratio, after which the residual has the size
     * that is to be expected (R. T. Birge, Phys. Rev. 40, 1932).
     */
    void draw(const phase_reading& wanted, curve& out) const;

private:
    struct branches;

    void draw_rough(const phase_reading& wanted, branches& out) const;
    void halve(const phase_reading& wanted,
               const press_fit::point& from,
               const press_fit::point& to,
               std::size_t branch,
               int halvings,
               double reach,
               curve& out) const;
    double inflation(double misfit) const;

    press_fit d_fit;
    double d_consistent;
    std::vector<std::size_t> d_forces; // nodes of the table at which branches are sought
    location_scan d_scan;
};

} // namespace gr::wiforce::kernel
