// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "press_image.h"

#include <array>
#include <complex>

namespace gr::wiforce::kernel {

/*!
 * \brief How the amplitudes of both ends follow their phases where switches reflect.
 *
 * R = (e^{j psi} - off) / (e^{j psi0} - off) lies on a circle, so that its phase
 * determines its amplitude. Where the off states of the ends differ, a rotation of both
 * ends changes the difference of their amplitudes, and a turn of the tag does not.
 */
class off_states
{
public:
    /*!
     * \param untouched psi0 of both ends, rad
     * \param off G_off / rho of both switches, each of a magnitude below 1
     * \param std of the real and the imaginary part of each
     */
    off_states(const pair_of_ends& untouched,
               const std::array<std::complex<double>, 2>& off,
               double std);

    //! Whether amplitudes distinguish a turn of the tag from a press. A rotation of both
    //! ends changes the difference of ln |R| by about that of the off states, which must
    //! exceed two standard deviations of what a contact loses at one end, and five of its
    //! own.
    bool differ(double contact_np) const;
    //! ln |R| of both ends whose phases have changed by this.
    pair_of_ends amplitude(const pair_of_ends& change) const;
    //! By how much their difference grows where both phases do, Np per rad.
    double slope(const pair_of_ends& change) const;
    //! Variance, Np^2, of what this difference changes by with phases, by what is unknown
    //! of the off states.
    double variance(const pair_of_ends& change) const;

private:
    struct end {
        std::complex<double> untouched{ 1, 0 }, off{ 0, 0 };

        double amplitude(double change) const;
        double slope(double change) const;
        // By how much the amplitude grows with both parts of the off state.
        std::complex<double> sensitivity(double change) const;
    };

    std::array<end, 2> d_end{};
    double d_std = 0;
};

} // namespace gr::wiforce::kernel
