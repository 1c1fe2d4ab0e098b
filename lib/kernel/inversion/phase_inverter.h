// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "calibrated_span.h"
#include "inverse_table.h"
#include "likelihood_profile.h"

#include <cstddef>
#include <cstdint>
#include <memory>

namespace gr::wiforce::kernel {

/*!
 * \brief Two phases of one carrier to force and location, with doubts flagged.
 *
 * By the inverse table where it holds, else by the profile of the likelihood.
 */
class phase_inverter
{
public:
    enum flag : std::uint8_t {
        ambiguous = 1,    //!< another press would show the same phases
        unobservable = 2, //!< force and location cannot be told apart
        inconsistent = 4, //!< no single press shows such phases
        extrapolated = 8, //!< outside what was calibrated
        unknown = 16      //!< neither table holds it: search the model
    };

    struct reading {
        double force, location;
        double covariance[4]; //!< (force, location) x (force, location)
    };

    //! Where solutions are looked for, and how large a misfit they may leave.
    struct limits {
        double low_n, high_n, left_mm, right_mm, misfit;
    };

    phase_inverter(inverse_table table,
                   std::shared_ptr<const likelihood_profile> profile,
                   calibrated_span span,
                   limits limits);

    //! Phases and their standard deviations in degrees; gives the reading's flags.
    std::uint8_t
    read(double psi_1, double psi_2, double std_1, double std_2, reading& out) const;

    /*!
     * Reads many pairs, on all processors.
     *
     * \param psi count x 2 phases, deg
     * \param std count x 2 standard deviations, deg
     * \param count of pairs
     * \param out count readings; what stands where a flag is unknown means nothing
     * \param flags count sums of flags
     */
    void read_all(const double* psi,
                  const double* std,
                  std::size_t count,
                  reading* out,
                  std::uint8_t* flags) const;

private:
    bool in_domain(double force, double location) const;
    std::uint8_t
    profiled(double psi_1, double psi_2, double std_1, double std_2, reading& out) const;

    inverse_table d_table;
    std::shared_ptr<const likelihood_profile> d_profile;
    calibrated_span d_span;
    limits d_limits;
};

} // namespace gr::wiforce::kernel
