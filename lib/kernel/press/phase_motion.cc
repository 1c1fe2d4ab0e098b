// SPDX-License-Identifier: GPL-3.0-or-later
#include "phase_motion.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

constexpr double least_determinant = 1e-300;

} // namespace

double log_normal(double x, double variance)
{
    return -0.5 * (x * x / variance + std::log(two_pi * variance));
}

phase_covariance
covariance_along(const pair_of_ends& direction, double along, double across)
{
    const double x = direction[0], y = direction[1];
    return { along * x * x + across * y * y,
             along * y * y + across * x * x,
             (along - across) * x * y };
}

void phase_motion::hold(const pair_of_ends& phase, const phase_covariance& covariance)
{
    phase_motion held;
    held.d_state[0] = phase[0], held.d_state[1] = phase[1];
    held.widen(covariance);
    *this = held;
}

void phase_motion::widen(const phase_covariance& by)
{
    d_covariance[0][0] += by.first;
    d_covariance[1][1] += by.second;
    d_covariance[0][1] += by.both;
    d_covariance[1][0] += by.both;
}

void phase_motion::move(double velocity)
{
    for (const int i : { 2, 3, turns }) {
        if (i >= d_size)
            break;
        d_state[i] = velocity;
        for (int j = 0; j < d_size; j++)
            d_covariance[i][j] = d_covariance[j][i] = 0;
    }
    widen_turn_velocity(velocity * velocity / 4);
}

void phase_motion::widen_velocity(const phase_covariance& by)
{
    d_covariance[2][2] += by.first;
    d_covariance[3][3] += by.second;
    d_covariance[2][3] += by.both;
    d_covariance[3][2] += by.both;
}

void phase_motion::stop(double seconds)
{
    // On average in the middle.
    const double first = d_state[2] * seconds / 2, second = d_state[3] * seconds / 2;
    const auto reached = covariance();
    hold({ d_state[0] - first, d_state[1] - second },
         { reached.first + first * first,
           reached.second + second * second,
           reached.both + first * second });
}

void phase_motion::predict(double seconds)
{
    const int velocity[] = { 2, 3, 0, 0, turns };
    for (const int i : { 0, 1, line }) {
        if (i >= d_size)
            break;
        d_state[i] += seconds * d_state[velocity[i]];
        for (int j = 0; j < d_size; j++)
            d_covariance[i][j] += seconds * d_covariance[velocity[i]][j];
        for (int j = 0; j < d_size; j++)
            d_covariance[j][i] += seconds * d_covariance[j][velocity[i]];
    }
}

void phase_motion::join(double common, double both, double loss)
{
    d_size = most;
    d_state[line] = d_state[lost] = 0;
    d_covariance[line][line] = common;
    d_covariance[line][lost] = d_covariance[lost][line] = both;
    d_covariance[lost][lost] = loss;
}

void phase_motion::forget_turn()
{
    d_size = 4;
    for (int i = d_size; i < most; i++) {
        d_state[i] = 0;
        for (int j = 0; j < most; j++)
            d_covariance[i][j] = d_covariance[j][i] = 0;
    }
}

void phase_motion::widen_alike(const std::array<int, 3>& which, double variance)
{
    for (const int i : which)
        for (const int j : which)
            if (i < d_size && j < d_size)
                d_covariance[i][j] += variance;
}

void phase_motion::stop_press(double seconds)
{
    const double first = (d_state[2] - d_state[turns]) * seconds / 2,
                 second = (d_state[3] - d_state[turns]) * seconds / 2;
    turn({ -first, -second });
    widen({ first * first, second * second, first * second });
    for (const int i : { 2, 3 }) {
        d_state[i] = d_state[turns];
        for (int j = 0; j < d_size; j++)
            d_covariance[i][j] = d_covariance[turns][j];
    }
    for (const int i : { 2, 3 })
        for (int j = 0; j < d_size; j++)
            d_covariance[j][i] = d_covariance[j][turns];
}

void phase_motion::stop_turn(double seconds)
{
    const double by = d_state[turns] * seconds / 2;
    turn(-by);
    d_state[line] -= by;
    widen_turn(by * by);
    for (const int i : { 2, 3 }) {
        d_state[i] -= d_state[turns];
        for (int j = 0; j < d_size; j++)
            d_covariance[i][j] -= d_covariance[turns][j];
    }
    for (const int i : { 2, 3 })
        for (int j = 0; j < d_size; j++)
            d_covariance[j][i] -= d_covariance[j][turns];
    d_state[turns] = 0;
    for (int j = 0; j < d_size; j++)
        d_covariance[turns][j] = d_covariance[j][turns] = 0;
}

void phase_motion::update_loss(double slope, double off, double variance)
{
    double gain[most];
    for (int i = 0; i < d_size; i++) {
        gain[i] = (slope * d_covariance[i][line] + d_covariance[i][lost]) / variance;
        d_state[i] += gain[i] * off;
    }
    for (int i = 0; i < d_size; i++)
        for (int j = 0; j < d_size; j++)
            d_covariance[i][j] -= gain[i] * gain[j] * variance;
}

bool phase_motion::near(const phase_motion& other) const
{
    for (const int i : { 0, 1, 2, 3, turns }) {
        const double off = i < 2 ? wrapped(d_state[i] - other.d_state[i])
                                 : d_state[i] - other.d_state[i];
        if (off * off > 0.1 * d_covariance[i][i])
            return false;
    }
    return true;
}

phase_motion::expectation phase_motion::expected(const pair_of_ends& phase,
                                                 const phase_covariance& noise) const
{
    const double first = d_covariance[0][0] + noise.first,
                 second = d_covariance[1][1] + noise.second,
                 both = d_covariance[0][1] + noise.both;
    return { { wrapped(phase[0] - d_state[0]), wrapped(phase[1] - d_state[1]) },
             { first, second, both },
             std::max(first * second - both * both, least_determinant) };
}

double phase_motion::expect(const pair_of_ends& phase,
                            const phase_covariance& noise) const
{
    const auto [off, of, determinant] = expected(phase, noise);
    const double square = off[0] * off[0] * of.second - 2 * off[0] * off[1] * of.both +
                          off[1] * off[1] * of.first;
    return -0.5 * (square / determinant + std::log(determinant)) - std::log(two_pi);
}

double phase_motion::update(const pair_of_ends& phase, const phase_covariance& noise)
{
    const double likelihood = expect(phase, noise);
    const auto [off, of, determinant] = expected(phase, noise);
    double gain[most][2], rest[most][most];
    for (int i = 0; i < d_size; i++) {
        const double to_first = d_covariance[i][0], to_second = d_covariance[i][1];
        gain[i][0] = (to_first * of.second - to_second * of.both) / determinant;
        gain[i][1] = (to_second * of.first - to_first * of.both) / determinant;
        d_state[i] += gain[i][0] * off[0] + gain[i][1] * off[1];
        for (int j = 0; j < d_size; j++)
            rest[i][j] = d_covariance[i][j] - gain[i][0] * d_covariance[0][j] -
                         gain[i][1] * d_covariance[1][j];
    }
    // Joseph's form: after a gap a turn that both ends share is known to radians, and its
    // difference to microradians, which the shorter form would leave negative.
    for (int i = 0; i < d_size; i++) {
        const double by_first = gain[i][0] * noise.first + gain[i][1] * noise.both,
                     by_second = gain[i][0] * noise.both + gain[i][1] * noise.second;
        for (int j = 0; j <= i; j++)
            d_covariance[i][j] = d_covariance[j][i] =
                rest[i][j] + (by_first - rest[i][0]) * gain[j][0] +
                (by_second - rest[i][1]) * gain[j][1];
    }
    return likelihood;
}

} // namespace gr::wiforce::kernel
