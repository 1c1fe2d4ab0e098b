// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

// What the parts of the press filter share: fixed terms of the model, in units.

#include "drift_bank.h"
#include "phase_motion.h"

#include <array>
#include <cmath>

namespace gr::wiforce::kernel {

// Explanations that are kept, and of them those that agree on where the untouched line
// lies: otherwise the many courses of what is likely leave no room for what is not. And
// the logarithm of a weight that counts: of 1e-8.
constexpr std::size_t most_kept = 32, most_of_line = 12;
constexpr double negligible = -18;
// Explanations with less weight than this change no reading.
constexpr double least_weight = 1e-5;
constexpr double deg = two_pi / 360;
// Speeds of steady changes, rad/s: a force that creeps, rises, is applied quickly, is a
// tap.
constexpr std::array<double, 4> speeds{ 5 * deg, 50 * deg, 500 * deg, 3000 * deg };
constexpr std::size_t turning_speeds = 3, near_speeds = 2; // of tags, and of hands nearby
// Turns keep their speed for about so long.
constexpr double least_turn_s = 0.05;
// A sudden change that takes no more than this of a group is not seen to be inside it.
constexpr double unseen_s = 0.004;
// Contacts change the phases by more.
constexpr double least_contact_deg = 10;
// By how much a press at one location changes the phases, at once.
constexpr double jump_deg = 10, least_jump_deg = 2;
// Presses that slide, of those that change steadily.
constexpr double sliding = 0.2;
// Change of the phases by the force in a group in which a press begins or ends.
constexpr double ramp_deg = 4;
// Density per rad^2 below which the model does not contain a press.
constexpr double outside = 0.003;
// Variance of a phase of which nothing is known, rad^2.
constexpr double unknown_phase = two_pi * two_pi / 12;
// Spread of amplitudes of contacts that the model does not contain, Np.
constexpr double any_amplitude = 0.3;

inline double log_sum(double a, double b)
{
    return a > b ? a + std::log1p(std::exp(b - a)) : b + std::log1p(std::exp(a - b));
}

// Mean of exp(-t) for t up to x.
inline double part_of_decay(double x) { return x > 1e-9 ? -std::expm1(-x) / x : 1; }

inline double squared(double x) { return x * x; }

// Of phases and amplitudes that may be anything.
inline const double log_any_phases = -2 * std::log(two_pi);
inline const double log_any_mixture = log_any_phases - 2 * std::log(0.7);

inline const pair_of_ends alike_both{ std::sqrt(0.5), std::sqrt(0.5) };


} // namespace gr::wiforce::kernel
