// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "tabulated_model.h"

#include <optional>

namespace gr::wiforce::kernel {

//! What is to be explained: phases (deg, modulo 360), standard deviations of their noise
//! (deg), and the location (mm) where it is known, else null. `shared` is what one
//! standard deviation of an error that all phases share adds to each (deg); null for
//! none.
struct phase_reading {
    const double *phase, *std, *location, *shared = nullptr;
};

/*!
 * \brief Weighted least squares of a press: of its location at a given force, and of
 * both.
 *
 * The weights are the inverse of the covariance of the noise and the model's error
 * together.
 */
class press_fit
{
public:
    //! A force and the location that explains the phases best.
    struct point {
        double steps; //!< of the table's nodes, counted from its first force
        double force, location;
        double variance;   //!< of the location at this force, mm^2
        double scale;      //!< of the likelihood integrated over location
        bool unobservable; //!< force and location cannot be distinguished here
        double residual[tabulated_model::most_phases]; //!< in standard deviations,
                                                       //!< uncorrelated
    };

    //! A press and its covariance, N and mm.
    struct press {
        double force, location;
        double force_variance, covariance, location_variance;
    };

    explicit press_fit(tabulated_model model) : d_model(std::move(model)) {}

    const tabulated_model& model() const { return d_model; }

    //! Fits the location at a force, from where `at` stands, by steps of up to `reach_mm`
    //! until they are below `tolerance_mm`.
    void at_force(const phase_reading& wanted,
                  double reach_mm,
                  double tolerance_mm,
                  point& at) const;

    //! Fits force and location, starting at a point; the covariance is that of phases
    //! linear in both. Nothing if the fit leaves the table.
    std::optional<press>
    best(const phase_reading& wanted, double steps, double location) const;

    //! Whether noise of `std_deg` hides force behind location.
    bool unobservable(double force, double location, double std_deg) const;

private:
    tabulated_model d_model;
};

} // namespace gr::wiforce::kernel
