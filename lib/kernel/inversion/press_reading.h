// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../phases/sensor_groups.h"
#include "../press/explanation.h"
#include "press_posterior.h"

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>

namespace gr::wiforce::kernel {

/*!
 * \brief Touch, force, location and flags of a sensor's group: the mean over all that may
 * have happened to it.
 *
 * The likeliest explanation and all other presses whose untouched line is known are
 * inverted, with the covariance of both phases.
 */
class press_reading
{
public:
    using complex = std::complex<double>;
    using pair = std::array<double, 2>;

    //! What is known of the sensor.
    struct sensor {
        pair untouched_rad;
        std::array<complex, 2> off; // G_off / rho of both switches
        double off_std; // of the real and the imaginary part of each off state
        // Whether phases are those of arg R alone, on the circle of |G| = rho: what turns
        // the tag changes |R| of both ends as well.
        bool off_states_differ;
        double tag_ratio; // amplitude of the tag over the static path; 0 for one antenna
        double ruler_mm2; // variance of all locations by the ruler
    };

    //! Bits of the flags.
    struct bits {
        std::int64_t transition, weak, ambiguous, force_unobservable, inconsistent,
            extrapolated, moved;
    };

    //! Standard deviations that are flagged, and the probability that is.
    struct limits {
        double weak_phase_deg, weak_force_n, doubt;
    };

    press_reading(const press_posterior& posterior,
                  const sensor& of,
                  const bits& flags,
                  const limits& at);

    //! NaN is unknown. `level` is R against the untouched line, `clear` whether nothing
    //! but the inversion flags the group, `unexplained` whether nothing does but that it
    //! is most likely no press of the model, `doubtful` whether it is not known which
    //! phases are those untouched.
    struct reading {
        std::int64_t touch; // 1, 0 or, where it is unknown, -1
        double force_n, force_std_n, location_mm, location_std_mm;
        pair phases_deg;
        double snr_db;
        std::int64_t flags, group;
        double interference;
        pair psi_std_deg;
        std::array<complex, 2> level;
        bool clear, unexplained, doubtful;
    };

    //! What may have happened in the group, the likeliest explanation first. Force and
    //! location only where they are `wanted`.
    reading read(const sensor_group& of,
                 const press_outcome* first,
                 const press_outcome* end,
                 bool wanted,
                 press_posterior::workspace& work) const;

private:
    struct phases {
        std::array<complex, 2> level;
        pair deg, own_deg, shared_deg;
    };
    phases phases_of(const press_outcome& of, double rotation_variance) const;
    void invert(const phases& likeliest,
                double rotation_variance,
                const press_outcome* first,
                const press_outcome* end,
                reading& to,
                press_posterior::workspace& work) const;

    const press_posterior& d_posterior;
    const sensor d_sensor;
    const bits d_bits;
    const limits d_limits;
};

} // namespace gr::wiforce::kernel
