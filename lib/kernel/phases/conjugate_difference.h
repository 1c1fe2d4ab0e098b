// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "profile_check.h"

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Channels V of E ends on K subcarriers in a group.
struct end_channels {
    std::complex<double>* values; // E x K
    const double* gain;           // E: variance of V over that of H, infinite without V
    const double* noise;          // K: variance of H
    const double* noise_rise;     // K: the same over that before; null where not known
};

// What the ends are compared with.
struct reference_channels {
    const std::complex<double>* values; // E x K
    const double* gain; // E: variance over that of H, infinite without one
};

// A group's ends against their reference.
struct difference {
    std::vector<double> gain;   // E: of the ends, with deviations from the profile
    std::vector<double> power;  // E: weighted mean of |V_ref|^2; 0 without a reference
    std::vector<char> reshaped; // E: varies over the subcarriers unlike its reference
};

// Replaces V by V conj(V_ref) over the reference's power, so that the weighted mean over
// the subcarriers is R. By the check, where there is one, images are removed before.
difference conjugate_difference(const end_channels& ends,
                                const reference_channels& reference,
                                std::size_t end_count,
                                std::size_t subcarriers,
                                profile_check* check);

// Ratios R of the ends of a group, and the standard deviations of their phases, in
// degrees; infinite where there is none.
struct ratio {
    std::complex<double> value;
    double phase_std_deg;
};

// R = sum_k w_k X_k with w_k = 1 / sigma_k^2 for changes X of an end (K). Its variance is
// g (1 + g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2, where g and g_ref are the
// gains of V and V_ref.
ratio subcarrier_average(const std::complex<double>* changes,
                         const double* noise,
                         std::size_t subcarriers,
                         double gain,
                         double reference_gain,
                         double reference_power);

} // namespace gr::wiforce::kernel
