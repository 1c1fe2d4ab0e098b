// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>

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

    // Advances to a time and corrects by the group's likelihood; false when it lacks the
    // tag, and the clock then coasts. `likelihood`: J, J' and J'' of the group at the
    // predicted phase, without the other tags. `noise_level`: scales the energy of a mean
    // group. `measured`: the error of that phase, instead of the likelihood's; may be
    // null.
    bool update(double at_s,
                const double* likelihood,
                double noise_level,
                const measurement* measured);

private:
    void advance(double at_s);
    bool is_present(double energy, double expected) const;

    double d_nominal, d_subcarriers, d_slope_variance, d_drift_power;
    double d_energy, d_curvature;
    std::size_t d_groups;
};

// A tag's clock is given up when the tag was absent, or not received, for this long.
struct clock_limits {
    double absent_s, unseen_s;

    bool expired(const clock_tracker& clock, double at_s) const
    {
        return clock.time_s - clock.seen_s > absent_s || at_s - clock.seen_s > unseen_s;
    }
};

} // namespace gr::wiforce::kernel
