// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "end_fit.h"

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// A least-squares fit, expanded to second order in the phases of the clocks of its S
// tags. With t = (1 - M M^+) dM/dtheta V, the derivative of the model that a change of
// the ends cannot compensate, the residual of a group is r - t dtheta (variable
// projection, G. Golub and V. Pereyra, 1973).
class phase_expansion
{
public:
    explicit phase_expansion(const end_fit& fit);

    const end_fit::shape sizes;
    std::vector<double> power; // K of each group: sum of the squared residual

    // Sum of the squared residual, K of each of the first groups, at other phases:
    // `shifts`, S of each of them, is by how much these exceed those of the fit, in rad.
    std::vector<double> power_at(const double* shifts, std::size_t groups) const;

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
    std::vector<std::complex<double>> d_gram; // E x E: t^H t without the ends
    std::vector<double> d_gradient;           // S x K: derivatives of -power
    std::vector<double> d_excess;             // S
};

} // namespace gr::wiforce::kernel
