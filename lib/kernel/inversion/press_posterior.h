// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "likelihood_profile.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * \brief The forces and locations that a calibration covers.
 *
 * From the first to the last location the lowest and the highest force are straight lines
 * from one location to the next.
 */
class calibrated_span
{
public:
    //! Locations rise; all three are of one size.
    calibrated_span(std::vector<double> location_mm,
                    std::vector<double> low_n,
                    std::vector<double> high_n);

    //! Whether a press lies within.
    bool contains(double force_n, double location_mm) const
    {
        return reaches(force_n, force_n, location_mm);
    }

    //! Whether a press lies outside by more than its standard deviation.
    bool extrapolated(double force_n,
                      double location_mm,
                      double force_variance,
                      double location_variance) const;

private:
    bool reaches(double lowest_n, double highest_n, double location_mm) const;

    std::vector<double> d_location, d_low, d_high;
};

//! What is to be known about an inverted reading; a reading may have several.
enum reading_flag : std::uint8_t {
    ambiguous = 1,          //!< another press would show the same phases
    force_unobservable = 2, //!< force and location cannot be distinguished
    inconsistent = 4,       //!< no single press shows such phases
    extrapolated = 8        //!< outside what was calibrated
};

/*!
 * \brief The posterior of force and location given the phases of a reading.
 *
 * Forces are log-uniform beforehand and locations uniform, as in press_image.h; noise and
 * the model's own error are normal. The likelihood is integrated over location about the
 * profile and over force along it, in closed form from point to point.
 *
 * Its parts with a dip of the likelihood between are different solutions. The solution
 * with the largest part of the posterior is reported, by its mean; the calibrated span
 * decides first. The covariance is about that mean and includes the other solutions.
 */
class press_posterior
{
public:
    press_posterior(tabulated_model model, calibrated_span span, double consistent);

    std::size_t phases() const { return d_profile.fit().model().phases(); }
    const likelihood_profile& profile() const { return d_profile; }
    const calibrated_span& span() const { return d_span; }

    class workspace;

    //! Inverts one reading; gives the sum of its flags. `work` may be used again to save
    //! the time for its memory.
    std::uint8_t
    invert(const phase_reading& wanted, workspace& work, press_fit::press& out) const;

private:
    // Sums of the likelihood times powers of force and location.
    struct moments {
        double mass = 0, force = 0, force_2 = 0, location = 0, location_2 = 0,
               product = 0;
        double unobservable = 0, outside = 0;

        void operator+=(const moments& other);
    };

    struct solution {
        moments sums;
        double misfit;       // least of its segments, which is at
        std::size_t best;    // this one
        bool inside() const; // the calibrated span, at least in part
    };

    // Integrals of the likelihood over a segment: of what is linear from one end to the
    // other, by the weights of its ends; of a product of two such, less `bend` times both
    // rises.
    struct weights {
        double left, right, bend;
    };

    void integrate(workspace& work) const;
    void find_solutions(workspace& work) const;
    void add(const workspace& work, std::size_t segment, moments& to) const;
    const solution& choose(const workspace& work) const;
    // The mean of a solution, and the covariance of all about it.
    static press_fit::press mean(const moments& solution, const moments& all);
    std::optional<press_fit::press> mode_near(const phase_reading& wanted,
                                              const likelihood_profile::curve& drawn,
                                              std::size_t segment) const;

    likelihood_profile d_profile;
    calibrated_span d_span;
};

class press_posterior::workspace
{
    friend press_posterior;

    likelihood_profile::curve curve;
    std::vector<double> z, density, outside;
    std::vector<weights> weight;
    std::vector<solution> solutions;
};

} // namespace gr::wiforce::kernel
