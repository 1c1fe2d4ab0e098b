// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"
#include "clock_tracker.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Least-squares fit of the tags' ends to the whitened parts of the tones of some groups
// (`group_weights.h`), each by itself: tones = mixing x ends + residual (docs/theory.md,
// Ends). Arrays hold the groups one after the other, matrices row by row.
class end_fit
{
public:
    // Sizes: groups, tones M (an even number), ends E of the tags that are fitted, two
    // each, and subcarriers K.
    struct shape {
        std::size_t groups, tones, ends, subcarriers;
    };

    // `mixed`: M x 2E of every group, the tags' waveforms as whitened tones, and behind
    // them their derivatives by the clocks' phases.
    end_fit(const shape& sizes, const double* mixed);

    // Fits tones of the groups, M x K, whitened.
    void solve(const complex* tones);

    const shape sizes;
    std::vector<double> mixing, slopes; // M x E
    std::vector<double> solver;         // E x M, the pseudo-inverse of the mixing
    std::vector<double> gain;           // E: variance of an end over that of H
    std::vector<complex> ends;          // E x K
    std::vector<complex> residual;      // M x K

    // Degrees of freedom of the residual of a group on one subcarrier.
    std::size_t freedom() const;

    // Sum of the squared residual over the tones, K of each group.
    std::vector<double> power() const;

private:
    void invert(); // the mixing
};

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
