// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <array>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// J = sum_k |u_k|^2 / sigma_k^2 and its first two derivatives by the phase of a clock,
// the likelihood of that phase: u = B^H D^-1 P of L lines P, D = diag(exp(j m theta)).
class clock_likelihood
{
public:
    // `derivatives`: 6 x L, both rows of B^H times each line's (-j m)^0, ^1 and ^2.
    clock_likelihood(std::vector<complex> derivatives, std::vector<double> lines);

    std::size_t lines() const { return d_lines.size(); }

    // At a phase, in rad, of L x K tones; `inverse_noise`: 1 / sigma_k^2, K.
    std::array<double, 3> at(double phase,
                             const complex* tones,
                             const double* inverse_noise,
                             std::size_t subcarriers) const;

private:
    const std::vector<complex> d_derivatives;
    const std::vector<double> d_lines;
};

// Tracks a tag's free-running clock from group to group after its acquisition: a Kalman
// filter of phase and rate, on the gradient of the likelihood J at the predicted phase.
class clock_tracker
{
public:
    // An error of the phase and its variance, in rad and rad^2.
    struct measurement {
        double error, variance;
    };

    // As an acquisition gives it.
    double time_s = 0, phase = 0, rate = 0; // at this time; rad, rad/s above nominal
    std::array<double, 3> variances{};      // of the phase, the covariance, of the rate
    double nominal_rate = 0, subcarriers = 0;
    double slope_variance = 0;        // of J' by unit noise, of all subcarriers
    double energy = 0, curvature = 0; // J and J'' of a mean group, times the noise level,
    std::size_t groups = 0;           // and the number of groups that it is a mean of
    double seen_s = 0;                // centre of the last group that held the tag

    // The phase expected at a time, in rad.
    double predict(double at_s) const
    {
        return phase + (nominal_rate + rate) * (at_s - time_s);
    }

    // Whether a group with this likelihood at the predicted phase, as for `update`, holds
    // the tag.
    bool shown_by(const std::array<double, 3>& likelihood, double noise_level) const;

    // Advances to a time and corrects by the group's likelihood; false when it lacks the
    // tag, and the clock then coasts. `likelihood`: J, J' and J'' of the group at the
    // predicted phase, without the other tags. `noise_level`: scales the energy of a mean
    // group. `measured`: the error of that phase, instead of the likelihood's; may be
    // null.
    bool update(double at_s,
                const std::array<double, 3>& likelihood,
                double noise_level,
                const measurement* measured);

    // Whether it is to be given up: the tag was absent, or not received, for longer.
    bool expired(double at_s, double absent_s, double unseen_s) const
    {
        return time_s - seen_s > absent_s || at_s - seen_s > unseen_s;
    }

private:
    void advance(double at_s);
};

} // namespace gr::wiforce::kernel
