// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace gr::wiforce::kernel {

/*!
 * \brief A phase that walks randomly at an unknown rate.
 *
 * One Kalman filter for each of some rates, weighted by how well they predict. While
 * nothing is observed the variances go on growing, each at its own rate, so that what is
 * found afterwards teaches the rate as well.
 */
class drift_bank
{
public:
    static constexpr std::size_t most_rates = 6;

    struct moments {
        double mean, variance;
    };
    //! Another phase that is seen at once: how far it is off what was expected and the
    //! variance of that, covariances of the errors of both and of their noise, and
    //! whether the density is that of the phase beside it, or that of the phase alone.
    struct companion {
        double off, variance, errors, noise;
        bool known;
    };
    //! A phase that is seen, its noise, and what is seen beside it.
    struct observation {
        double phase, noise;
        companion beside;
    };

    drift_bank() = default; // does not drift
    //! At the rates of the filter, or at the only one that is stated (rad per sqrt(s),
    //! negative to learn it), times `scale`.
    drift_bank(double scale, double stated);

    //! Begins at a phase; what is known of the rate stays.
    void reset(double phase, double variance);
    void turn(double by);
    void widen(double variance);
    //! Something else has been learned of it: its variance is so many times as large.
    void narrow(double ratio);
    //! Covariance with the one that it carries, and what both moved by, unknown alike.
    double with() const;
    void tie(double variance);
    void predict(double seconds);
    //! Takes a phase; gives the log density that was expected of it. `memory` is the part
    //! of the evidence for the rates that is kept. What is below `lowest` is of no use.
    double update(const observation& seen, double memory, double lowest = -INFINITY);

    //! Likewise, where this phase is that of another which drifts, and of something that
    //! drifts beside it: half of what this one drifts is the other's. The share may be
    //! anything (arcsine law, variance 1 / 8), which is the other's doubt.
    double carry(drift_bank& other, const observation& seen, double memory);

    //! A share of what another says, and the rest of what it says itself, in one.
    void merge(const drift_bank& other, double share);

    moments estimate() const { return d_estimate; }
    //! Geometric mean of the rates, when it was predicted.
    double usual_rate() const { return d_usual_rate; }

private:
    // The innovation that the companion leaves, its variance, and by how much of both the
    // phase is corrected.
    struct correction {
        double off, variance, gain, gain_of_companion;
    };
    correction
    correct(std::size_t rate, double off, double noise, const companion& beside) const;
    double mean_of(const std::array<double, most_rates>& each) const;
    void find_usual_rate();
    void summarize(); // after each change: many explanations share what did not change

    moments d_estimate{ 0, 0 };
    double d_scale = 0, d_usual_rate = 0;
    std::size_t d_count = 1;
    std::array<double, most_rates> d_mean{}, d_variance{}, d_weight{ 1 },
        d_with{}; // covariance with the one that is carried
    // How far that one was carried since the reset, and the square of the farthest.
    double d_carried = 0, d_farthest2 = 0;
};

} // namespace gr::wiforce::kernel
