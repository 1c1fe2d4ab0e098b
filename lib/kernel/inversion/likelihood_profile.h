// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "phase_grid.h"

#include <array>
#include <cstddef>
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

    static constexpr std::size_t most_nodes = 32;

    //! Rows of a cell: two where a turn of phase brings another location near.
    struct cell {
        std::int32_t first, count;
    };

    //! What the rows of a cell say.
    struct turns {
        int count;
        reading first, second;
    };

    /*!
     * \param force nodes, rising, N
     * \param rows rows x columns x nodes
     * \param holds rows x (nodes - 1): whether z is a line on that segment
     * \param cells of the plane of both phases
     */
    likelihood_profile(std::vector<double> force,
                       std::vector<float> rows,
                       const std::vector<std::uint8_t>& holds,
                       std::vector<cell> cells);

    std::size_t rows() const;

    //! Reads by every row of the phases' cell; phases in degrees, their noise in deg^2.
    turns read_turns(double psi_1, double psi_2, double noise_1, double noise_2) const;

    //! Reads by one row; phases in degrees from the centre of its cell, their noise in
    //! deg^2.
    reading read(std::size_t row,
                 double offset_1,
                 double offset_2,
                 double noise_1,
                 double noise_2) const;

    //! Sums of the likelihood times powers of force and location.
    struct moments {
        double mass = 0, force = 0, force_2 = 0, place = 0, place_2 = 0, product = 0;
        double hidden = 0, outside = 0;

        void operator+=(const moments& other);
    };

private:
    using column_values = std::array<double, most_nodes>;

    // The profile of one pair of phases, at the nodes and on the segments between.
    struct curve {
        column_values z, place, width, scale;
        column_values misfit; // least z^2, infinite where z is no line
        double best;          // least misfit
    };

    // Integrals of the likelihood, segment by segment: of what is a straight line from
    // node to node, by the weights of its ends; of a product of two such, less `bend`
    // times both rises.
    struct weights {
        column_values left, right, bend;
    };

    curve draw(std::size_t row,
               double offset_1,
               double offset_2,
               double noise_1,
               double noise_2) const;
    weights weigh(const curve& drawn, std::size_t low, std::size_t high) const;
    moments sum(const float* values,
                const curve& drawn,
                const weights& by,
                std::size_t first,
                std::size_t last,
                double hidden_from) const;

    std::vector<double> d_force;
    std::vector<float> d_rows;   // half the memory to wait for
    std::vector<float> d_closed; // 0 where a segment holds, else infinity
    std::vector<cell> d_cells;
    phase_grid d_grid;
};

} // namespace gr::wiforce::kernel
