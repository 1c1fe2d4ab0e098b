// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

constexpr double two_pi = 6.283185307179586;

//! The angle in [-pi, pi].
double wrapped(double angle);

inline const pair_of_ends alike_both{ std::sqrt(0.5), std::sqrt(0.5) };

/*!
 * \brief What presses look like: changes of both phases against the untouched line.
 *
 * Forces are log-uniform from the onset to 1.3 times the calibrated force, locations
 * uniform over the line. The density is that of all presses that change the phases alike,
 * so that presses half a wavelength apart need no treatment of their own.
 */
class press_image
{
public:
    /*!
     * \param change (forces, locations, 2), rad; forces rise by equal ratios
     * \param spread rad; standard deviation by which models are wrong
     */
    press_image(const std::vector<double>& change,
                std::size_t forces,
                std::size_t locations,
                double spread);

    //! Per rad^2.
    double density(const pair_of_ends& change) const;
    double largest_density() const { return d_largest; }
    //! Unit vector in which more force moves both phases, and the variance of its angle
    //! among the presses that look like this; anything where none does.
    struct heading {
        pair_of_ends along{ alike_both };
        double variance = 1;
    };
    heading direction(const pair_of_ends& change) const;

private:
    struct corner {
        std::size_t cell;
        double share;
    };

    static constexpr std::size_t cells = 180; // of 2 deg, around the circle
    // The cells between which the phases lie, for linear interpolation.
    static std::array<corner, 4> around(const pair_of_ends& change);
    void add(const double* change, const pair_of_ends& along, double spread);

    std::vector<double> d_density;
    double d_largest = 0;
    std::vector<pair_of_ends> d_along; // directions, by density
};

} // namespace gr::wiforce::kernel
