// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "press_image.h"

namespace gr::wiforce::kernel {

//! Covariance of two values that are mixtures from now on: the other part has this share,
//! and means that lie so far apart.
inline void mix_covariance(
    double& own, double others, double first_apart, double second_apart, double share)
{
    own += share * (others - own) + share * (1 - share) * first_apart * second_apart;
}

//! Likewise mean and variance.
inline void
mix_moments(double& mean, double& variance, double apart, double others, double share)
{
    mix_covariance(variance, others, apart, apart, share);
    mean += share * apart;
}

//! Covariance of both phases, rad^2.
struct phase_covariance {
    double first = 0, second = 0, both = 0;

    //! Variances of the mean of both and of their difference, and covariance of these.
    double of_mean() const { return (first + second + 2 * both) / 4; }
    double of_difference() const { return first + second - 2 * both; }
    double of_both() const { return (first - second) / 2; }
};

//! Of variances along a unit vector and across it.
phase_covariance
covariance_along(const pair_of_ends& direction, double along, double across);

//! log N(x; 0, variance).
double log_normal(double x, double variance);

/*!
 * \brief Both phases of a press: held, or changing steadily.
 *
 * A Kalman filter of the phases and their velocities; while the press is held the
 * velocities are zero and known.
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
    void widen(const phase_covariance& by) { add(by, 0); }
    //! Both phases turn, at this velocity with this deviation.
    void move(double velocity, double deviation);
    //! Both velocities change by this.
    void push(double by) { d_state[2] += by, d_state[3] += by; }
    void widen_velocity(const phase_covariance& by) { add(by, 2); }
    pair_of_ends velocity() const { return { d_state[2], d_state[3] }; }
    phase_covariance velocity_covariance() const
    {
        return { d_covariance[2][2], d_covariance[3][3], d_covariance[2][3] };
    }
    //! The velocities, but for this of both, turn by an angle.
    void bend(double angle, double common);
    //! A steady change ended somewhere in the last `seconds`.
    void stop(double seconds);
    void predict(double seconds);

    //! A share of another in one with what is left of this.
    void merge(const phase_motion& other, double share);
    //! Mean of both phases and their difference, and how fast they change.
    std::array<double, 4> means() const;
    std::array<double, 4> variances() const;
    //! Takes phases with this noise; returns the logarithm of their density.
    double update(const pair_of_ends& phase, const phase_covariance& noise);

private:
    void add(const phase_covariance& by, int at);

    double d_state[4] = {}; // phases, velocities
    double d_covariance[4][4] = {};
};

} // namespace gr::wiforce::kernel
