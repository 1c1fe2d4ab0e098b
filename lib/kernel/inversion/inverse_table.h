// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "phase_grid.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * \brief Two phases to force and location by a step of second order from a cell's centre.
 *
 * Where the likelihood is as narrow as the slopes at the solution say. The table is made
 * by sensor/inversetable.py.
 */
class inverse_table
{
public:
    //! About the centre of a cell: the solution and its derivatives by the phases.
    struct row {
        double force, location;
        double slope[4];      //!< of force by each phase, of location by each
        double bend_force[3]; //!< second derivatives 11, 12, 22
        double bend_location[3];
        double variance_1, variance_2; //!< of the model, deg^2
        double in_span;                //!< 1 if the whole cell is calibrated, else 0
        double trusted_deg; //!< largest standard deviation of a phase for this to hold
    };

    struct reading {
        double force, location, force_variance, location_variance, covariance;
        bool hidden;  //!< whether force cannot be told from location
        bool in_span; //!< surely calibrated
    };

    //! The row of each of cells x cells, -1 where there is none.
    inverse_table(std::vector<row> rows, std::vector<std::int32_t> row_of);

    //! Phases and their standard deviations in degrees; nothing where the table does not
    //! hold.
    std::optional<reading>
    read(double psi_1, double psi_2, double std_1, double std_2) const;

private:
    std::vector<row> d_rows;
    std::vector<std::int32_t> d_row_of;
    phase_grid d_grid;
};

} // namespace gr::wiforce::kernel
