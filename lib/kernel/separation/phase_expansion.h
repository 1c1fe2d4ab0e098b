// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../clocks/clock_tracker.h"
#include "end_fit.h"

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// A least-squares fit, expanded in the phases of the clocks of its S tags. With t = (1 -
// M M^+) dM/dtheta V, the derivative of the model that a change of the ends cannot
// compensate, the residual of a group is r - t dtheta (variable projection, G. Golub and
// V. Pereyra, 1973).
class phase_expansion
{
public:
    explicit phase_expansion(const end_fit& fit);

    const end_fit::shape sizes;

    // Of the clocks' phases at those of the fit; `inverse_noise`: 1 / sigma_k^2, K.
    struct information {
        std::vector<double> gradient; // S: of the log-likelihood
        std::vector<double> expected; // S x S: its expected negative curvature, without
                                      // what the noise in the ends adds
        std::vector<double> excess;   // S: that, the variance of the gradient from noise
    };
    information informed(const double* inverse_noise) const;

private:
    void expand(const end_fit& fit);
    std::size_t tags() const { return sizes.ends / 2; }

    std::vector<std::complex<double>> d_ends; // E x K of each group
    std::vector<double> d_gram;               // E x E: t^T t without the ends
    std::vector<double> d_gradient; // S x K: derivatives of minus the residual's power
    std::vector<double> d_excess;   // S
};

// Gauss-Newton step to be added to each of some phases in rad, and its variance; infinite
// where a group does not determine a phase. `of` is that of one group, or a sum.
std::vector<clock_tracker::measurement>
phase_errors(const phase_expansion::information& of);

} // namespace gr::wiforce::kernel
