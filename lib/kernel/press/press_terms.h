// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

// What the parts of the press filter share: fixed terms of the model, in units.

#include "phase_motion.h"

#include <array>
#include <cmath>

namespace gr::wiforce::kernel {

// Explanations that are kept; more are merged, by the evidence that is lost, or dropped.
constexpr std::size_t most_kept = 50;
// Nats: two are one where no more of the evidence for either is lost.
constexpr double no_loss = 0.1;
// Explanations with less weight change no reading.
constexpr double least_weight = 3e-5;
// Logarithm of a density or a weight that cannot count, below any other.
constexpr double lost = -1e300;
constexpr double deg = two_pi / 360; // rad
// Speeds of steady changes, and by how much they change in a root second, rad/s: forces
// that creep as slowly as a finger warms the line, that creep faster, rise, are applied
// quickly, are taps.
constexpr std::array<double, 5> speeds{
    1 * deg, 5 * deg, 50 * deg, 500 * deg, 3000 * deg
};
// Speeds of turns, rad/s: of a finger that warms the line from its contact on, then of
// tags, the first two of which are those of hands nearby; the last is that of a turn
// that is sudden in longer groups. What is no faster than
// `slow_turn` is not named: the deviation of the force holds it.
constexpr std::array<double, 5> turn_speeds{
    1 * deg, 5 * deg, 50 * deg, 500 * deg, 3000 * deg
};
constexpr std::size_t warm_speed = 0, slow_turn = 1, fast_turn = 4, hand_speeds = 2;
// s: mean time for which a finger warms the line, or this cools after a release; share
// of contacts, and of releases, that do.
constexpr double warm_s = 5.0, warming = 0.2;
// s: a hand changes amplitudes for so long at least, also in shorter groups.
constexpr double least_hand_s = 0.05;
// s: a sudden change that takes no more than this of a group is not seen to be inside it.
constexpr double unseen_s = 0.004;
// Probability that the group after a silence was received in part: in others whole groups
// were lost.
constexpr double part_silent = 0.5;
// deg: what changes both phases by less is no contact that the model does not contain.
constexpr double least_contact_deg = 10;
// Share of steady changes that slide, across the direction of more force.
constexpr double sliding = 0.2;
// deg: change of the phases by the force in a group in which a press begins or ends.
constexpr double ramp_deg = 4;
// Per rad^2: density of the image below which the model does not contain a press; 1 / 8
// of that of phases that may be anything.
constexpr double outside = 0.003;
// Of phases that no press of the model has it is low, not minus infinity.
inline double log_density(double density) { return std::log(density + 1e-12); }
// rad^2: variance of a phase of which nothing is known.
constexpr double unknown_phase = two_pi * two_pi / 12;
// Np: spread of amplitudes of contacts that the model does not contain.
constexpr double any_amplitude = 0.3;

inline double log_sum(double a, double b)
{
    return a > b ? a + std::log1p(std::exp(b - a)) : b + std::log1p(std::exp(a - b));
}

inline double squared(double x) { return x * x; }

// Log densities of phases, and of phases and amplitudes, that may be anything.
inline const double log_any_phases = -2 * std::log(two_pi);
inline const double log_any_mixture = log_any_phases - 2 * std::log(0.7);

} // namespace gr::wiforce::kernel
