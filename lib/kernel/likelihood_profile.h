// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * Two phases to force and location by the profile of the likelihood over force.
 *
 * At a given force the location that fits best leaves one number of the phases' error, z,
 * in standard deviations. Between nodes of force z is taken as a straight line, so that
 * the integrals of exp(-z^2 / 2) and its moments have closed forms, however narrow or
 * wide it is. The tables are made by sensor/profile.py.
 */
class likelihood_profile
{
public:
    //! What a row holds at each node of force; columns of a row.
    enum column {
        place,   //!< location that fits best at the centre of the row's cell, mm
        error_1, //!< what is left there of the phases' errors, deg
        error_2,
        slope_1, //!< of the phases by location, deg/mm
        slope_2,
        variance_1, //!< of the model, deg^2
        variance_2,
        free,   //!< N per deg of phase error where force is hidden, else 0
        inside, //!< 1 within the calibrated span, else 0
        columns
    };

    struct reading {
        double force, location, force_variance, location_variance, covariance;
        double misfit;    //!< of the best solution, squared standard deviations
        double hidden;    //!< part of the likelihood where force is hidden
        double outside;   //!< part of it outside the calibrated span
        double ambiguous; //!< 1 when another solution fits, with a barrier between
    };

    /*!
     * \param force nodes, rising, N
     * \param rows rows x columns x nodes
     * \param holds rows x (nodes - 1): whether z is a line on that segment
     */
    likelihood_profile(std::vector<double> force,
                       std::vector<double> rows,
                       std::vector<std::uint8_t> holds);

    std::size_t rows() const;

    //! Reads by one row; phases in degrees from the centre of its cell, their noise in
    //! deg^2.
    reading read(std::size_t row,
                 double offset_1,
                 double offset_2,
                 double noise_1,
                 double noise_2) const;

private:
    std::vector<double> d_force, d_rows;
    std::vector<std::uint8_t> d_holds;
};

} // namespace gr::wiforce::kernel
