// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Tracks a tag's free-running clock from group to group after its acquisition: a Kalman
// filter of phase and rate, on the gradient of the likelihood J at the predicted phase.
class clock_tracker
{
public:
    // An error of the phase and its variance, in rad and rad^2.
    struct measurement {
        double error, variance;
    };

    // What an acquisition gives.
    struct fit {
        double time_s, phase, rate;           // rad; rad/s above nominal
        double phase_variance, rate_variance; // of these
        double nominal_rate;                  // rad/s
        double subcarriers;
        double slope_variance; // of J' by unit noise, of all subcarriers
        // J and J'' of a mean group, times the noise level, and how many it is a mean of.
        double energy, curvature;
        std::size_t groups;
        double seen_s; // centre of its last group
    };

    explicit clock_tracker(const fit& start);

    double time_s, phase, rate;      // the clock at this time
    std::array<double, 3> variances; // of the phase, the covariance, of the rate
    double seen_s;                   // centre of the last group that held the tag

    // The phase expected at a time, in rad.
    double predict(double at_s) const
    {
        return phase + (d_nominal + rate) * (at_s - time_s);
    }

    // By how much the phase expected at a time exceeds another one, in rad.
    double ahead_of(double other, double at_s) const;

    // Advances to a time and corrects by the group's likelihood; false when it lacks the
    // tag, and the clock then coasts. `likelihood`: J, J' and J'' of the group, without
    // the other tags, at a phase that the predicted one exceeds by `ahead` rad.
    // `noise_level`: scales the energy of a mean group. `measured`: the error of that
    // phase, instead of the likelihood's; may be null.
    bool update(double at_s,
                const double* likelihood,
                double noise_level,
                const measurement* measured,
                double ahead);

private:
    void advance(double at_s);
    bool is_present(double energy, double expected) const;

    double d_nominal, d_subcarriers, d_slope_variance, d_drift_power;
    double d_energy, d_curvature;
    std::size_t d_groups;
};

// What G groups say of the clocks of S tags.
struct clock_measurements {
    const std::vector<double>& center_s; // G
    const double* assumed;               // G x S, phases in rad
    const double* likelihood;            // G x S x 3, J, J' and J'' at these phases
    // G x S, of these phases by the complete model; null where it is not used
    const clock_tracker::measurement* errors;
    double noise_level; // that the likelihoods are scaled by
};

// How long measurements and clocks are of use.
struct clock_limits {
    std::vector<double> reach_rad; // S, of clocks from the phases assumed
    // A tag's clock is given up when the tag was absent, or not received, for this long.
    double absent_s, unseen_s;

    bool expired(const clock_tracker& clock, double at_s) const
    {
        return clock.time_s - clock.seen_s > absent_s || at_s - clock.seen_s > unseen_s;
    }
};

// Clocks corrected by some groups, as many x S each.
struct followed_clocks {
    std::size_t groups = 0;
    std::vector<double> phase, rate;
    std::vector<char> received; // whether the group holds the tag
};

// Updates trackers by one group after the other, at least one, as long as limits allow.
followed_clocks follow_clocks(const std::vector<clock_tracker*>& clocks,
                              const clock_measurements& measured,
                              const clock_limits& limits);

} // namespace gr::wiforce::kernel
