// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "press_image.h"

#include <cmath>

namespace gr::wiforce::kernel {

//! Covariance of both phases, rad^2.
struct phase_covariance {
    double first = 0, second = 0, both = 0;
};

//! Of variances along a unit vector and across it.
phase_covariance
covariance_along(const pair_of_ends& direction, double along, double across);

//! log N(x; 0, variance).
double log_normal(double x, double variance);

/*!
 * \brief Both phases of a press: held, or changing steadily, or turning with the tag.
 *
 * A Kalman filter of the phases and their velocities; while the press is held the
 * velocities are zero and known. While the tag turns it also holds the untouched line's
 * common phase, the velocity of the turn, which is a part of both velocities, and what
 * the amplitudes lose apart: all that the phases and amplitudes of a group tell of each
 * other.
 */
class phase_motion
{
public:
    pair_of_ends phase() const { return { d_state[0], d_state[1] }; }
    phase_covariance covariance() const
    {
        return { d_covariance[0][0], d_covariance[1][1], d_covariance[0][1] };
    }

    //! Begins at a phase, without velocity.
    void hold(const pair_of_ends& phase, const phase_covariance& covariance);
    //! Stays where it is now.
    void rest() { hold(phase(), covariance()); }
    void turn(const pair_of_ends& by) { d_state[0] += by[0], d_state[1] += by[1]; }
    //! Both phases turn, by this on average.
    void turn(double by) { turn({ by, by }); }
    void widen(const phase_covariance& by);
    //! Both phases turn, at this velocity within its half.
    void move(double velocity);
    //! Of the press alone, and of the turn.
    double speed() const
    {
        return std::hypot(d_state[2] - d_state[turns], d_state[3] - d_state[turns]);
    }
    double common_velocity() const { return (d_state[2] + d_state[3]) / 2; }
    double turn_velocity() const { return d_state[turns]; }
    void widen_velocity(const phase_covariance& by);
    //! A steady change ended somewhere in the last `seconds`.
    void stop(double seconds);
    void predict(double seconds);

    //! What is known of the untouched line's common phase and of the loss, as variances;
    //! their means are counted from now on.
    void join(double common, double both, double loss);
    void forget_turn();
    double common() const { return d_state[line]; }
    double loss() const { return d_state[lost]; }
    double common_variance() const { return d_covariance[line][line]; }
    double common_with_loss() const { return d_covariance[line][lost]; }
    double loss_variance() const { return d_covariance[lost][lost]; }
    //! The tag has turned, or its velocity has changed, by this variance.
    void widen_turn(double variance) { widen_alike({ 0, 1, line }, variance); }
    void widen_turn_velocity(double variance) { widen_alike({ 2, 3, turns }, variance); }
    //! The press, or the turn, ended somewhere in the last `seconds`.
    void stop_press(double seconds);
    void stop_turn(double seconds);
    //! Takes a value of `slope` times the common phase plus the loss, off by this from
    //! what was expected with this variance.
    void update_loss(double slope, double off, double variance);

    //! Whether phases and velocities are the same within a third of what is known of
    //! them.
    bool near(const phase_motion& other) const;
    //! Takes phases with this noise; returns the logarithm of their density.
    double update(const pair_of_ends& phase, const phase_covariance& noise);
    //! This density alone.
    double expect(const pair_of_ends& phase, const phase_covariance& noise) const;

private:
    static constexpr int line = 4, turns = 5, lost = 6, most = 7;

    struct expectation {
        pair_of_ends off; // of the phases from what is expected
        phase_covariance of;
        double determinant;
    };

    expectation expected(const pair_of_ends& phase, const phase_covariance& noise) const;
    void widen_alike(const std::array<int, 3>& which, double variance);

    int d_size = 4; // while the tag does not turn
    // Phases, velocities; common phase, velocity of the turn, loss.
    double d_state[most] = {};
    double d_covariance[most][most] = {};
};

} // namespace gr::wiforce::kernel
