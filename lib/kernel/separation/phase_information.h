// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "clock_tracker.h"
#include "end_fit.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// What the groups of a least-squares fit tell of the phases of the clocks of its S tags,
// by its expansion in these. With t = (1 - M M^+) dM/dtheta V, the derivative of the
// model that a change of the ends cannot compensate, the residual of a group is r - t
// dtheta (variable projection, G. Golub and V. Pereyra, 1973).
struct phase_information {
    std::vector<double> gradient; // S: of the log-likelihood
    std::vector<double> expected; // S x S: its expected negative curvature, without what
                                  // the noise in the ends adds
    std::vector<double> excess;   // S: that, the variance of the gradient from noise
};

// At the phases of the fit, of each group; `inverse_noise`: 1 / sigma_k^2, K.
phase_information information_of(const end_fit& fit, const double* inverse_noise);

// Gauss-Newton step to be added to each of some phases in rad, and its variance; infinite
// where a group does not determine a phase. `of` is that of one group, or a sum.
std::vector<clock_tracker::measurement> phase_errors(const phase_information& of);

} // namespace gr::wiforce::kernel
