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

void phase_motion::add(const phase_covariance& by, int at)
{
    d_covariance[at][at] += by.first;
    d_covariance[at + 1][at + 1] += by.second;
    d_covariance[at][at + 1] += by.both;
    d_covariance[at + 1][at] += by.both;
}

void phase_motion::move(double velocity, double deviation)
{
    for (int i = 2; i < 4; i++) {
        d_state[i] = velocity;
        for (int j = 0; j < 2; j++)
            d_covariance[i][j] = d_covariance[j][i] = 0;
        for (int j = 2; j < 4; j++)
            d_covariance[i][j] = deviation * deviation;
    }
}

void phase_motion::bend(double angle, double common)
{
    const double cosine = std::cos(angle), sine = std::sin(angle);
    const auto rotate = [&](double& first, double& second) {
        const double was = first;
        first = cosine * was - sine * second;
        second = sine * was + cosine * second;
    };
    push(-common);
    rotate(d_state[2], d_state[3]);
    push(common);
    for (auto& row : d_covariance)
        rotate(row[2], row[3]);
    for (int j = 0; j < 4; j++)
        rotate(d_covariance[2][j], d_covariance[3][j]);
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
    for (int i = 0; i < 2; i++)
        d_state[i] += seconds * d_state[i + 2];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 4; j++)
            d_covariance[i][j] += seconds * d_covariance[i + 2][j];
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 2; j++)
            d_covariance[i][j] += seconds * d_covariance[i][j + 2];
}

void phase_motion::merge(const phase_motion& other, double share)
{
    double apart[4];
    for (int i = 0; i < 4; i++) {
        apart[i] = other.d_state[i] - d_state[i];
        if (i < 2)
            apart[i] = wrapped(apart[i]);
        d_state[i] += share * apart[i];
    }
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            mix_covariance(
                d_covariance[i][j], other.d_covariance[i][j], apart[i], apart[j], share);
}

std::array<double, 4> phase_motion::means() const
{
    const auto& x = d_state;
    return { (x[0] + x[1]) / 2, x[0] - x[1], (x[2] + x[3]) / 2, x[2] - x[3] };
}

std::array<double, 4> phase_motion::variances() const
{
    const auto phases = covariance(), velocities = velocity_covariance();
    return { phases.of_mean(),
             phases.of_difference(),
             velocities.of_mean(),
             velocities.of_difference() };
}

double phase_motion::update(const pair_of_ends& phase, const phase_covariance& noise)
{
    const double first = d_covariance[0][0] + noise.first,
                 second = d_covariance[1][1] + noise.second,
                 both = d_covariance[0][1] + noise.both,
                 determinant = std::max(first * second - both * both, least_determinant);
    const double off[2] = { wrapped(phase[0] - d_state[0]),
                            wrapped(phase[1] - d_state[1]) };
    const double square =
        off[0] * off[0] * second - 2 * off[0] * off[1] * both + off[1] * off[1] * first;
    double gain[4][2], rest[4][4];
    for (int i = 0; i < 4; i++) {
        const double to_first = d_covariance[i][0], to_second = d_covariance[i][1];
        gain[i][0] = (to_first * second - to_second * both) / determinant;
        gain[i][1] = (to_second * first - to_first * both) / determinant;
        d_state[i] += gain[i][0] * off[0] + gain[i][1] * off[1];
        for (int j = 0; j < 4; j++)
            rest[i][j] = d_covariance[i][j] - gain[i][0] * d_covariance[0][j] -
                         gain[i][1] * d_covariance[1][j];
    }
    // Joseph's form: after a gap a turn that both ends share is known to radians, and its
    // difference to microradians, which the shorter form would leave negative.
    for (int i = 0; i < 4; i++) {
        const double by_first = gain[i][0] * noise.first + gain[i][1] * noise.both,
                     by_second = gain[i][0] * noise.both + gain[i][1] * noise.second;
        for (int j = 0; j <= i; j++)
            d_covariance[i][j] = d_covariance[j][i] =
                rest[i][j] + (by_first - rest[i][0]) * gain[j][0] +
                (by_second - rest[i][1]) * gain[j][1];
    }
    return -0.5 * (square / determinant + std::log(determinant)) - std::log(two_pi);
}

} // namespace gr::wiforce::kernel
