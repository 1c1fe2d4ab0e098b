// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

namespace gr::wiforce::kernel {

// Variance of the phase and of the amplitude, rad^2 and Np^2, of the static path of a
// converter, of 2 mdeg: of the receiver, no less.
constexpr double least_receiver_variance = 1e-9;

//! A group: R of both ends as phases and amplitudes, and what is known beside them.
struct press_observation {
    double time_s = 0;
    pair_of_ends phase{}, amplitude{}; // rad, Np
    pair_of_ends variance{};           // of each, by the noise of the group alone
    double common_variance = 0;        // of a rotation of both ends, rad^2
    // How the static path turned and grew since the group before, and the variance of
    // what it does when the receiver does not step.
    double receiver_phase = 0, receiver_amplitude = 0, receiver_variance = 0;
    bool retuned = false; // the receiver's phase is a new one
    double untouched = 0; // probability, where the user says so
};

} // namespace gr::wiforce::kernel
