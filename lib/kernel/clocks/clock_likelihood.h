// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// J = sum_k |u_k|^2 / sigma_k^2 and its first two derivatives by the phase of a clock,
// the likelihood of that phase: u = B^H D^-1 P of L lines P, D = diag(exp(j m theta)).
class clock_likelihood
{
public:
    // `derivatives`: 6 x L, both rows of B^H times each line's (-j m)^0, ^1 and ^2.
    clock_likelihood(std::vector<std::complex<double>> derivatives,
                     std::vector<double> lines);

    std::size_t lines() const { return d_lines.size(); }

    // At a phase, in rad, of L x K tones; `inverse_noise`: 1 / sigma_k^2, K.
    std::array<double, 3> at(double phase,
                             const std::complex<double>* tones,
                             const double* inverse_noise,
                             std::size_t subcarriers) const;

private:
    const std::vector<std::complex<double>> d_derivatives;
    const std::vector<double> d_lines;
};

} // namespace gr::wiforce::kernel
