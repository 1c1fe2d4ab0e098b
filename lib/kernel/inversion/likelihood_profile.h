// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "location_scan.h"
#include "press_fit.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

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
