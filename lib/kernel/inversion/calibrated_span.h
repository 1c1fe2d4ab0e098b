// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

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

} // namespace gr::wiforce::kernel
