// SPDX-License-Identifier: GPL-3.0-or-later
#include "drift_bank.h"

#include "phase_motion.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// Degrees per sqrt(s): from what nobody notices in a minute to what hides a press in a
// second.
constexpr double rates_deg[drift_bank::most_rates] = { 0.003, 0.03, 0.1, 0.3, 1.0, 3.0 };
constexpr double least_variance = 1e-14;
// A rate that seemed impossible may return.
constexpr double least_weight = 1e-100;

} // namespace

drift_bank drift_bank::learning(double scale)
{
    drift_bank bank;
    bank.d_count = most_rates;
    for (std::size_t i = 0; i < most_rates; i++) {
        bank.d_rate[i] = scale * rates_deg[i] * two_pi / 360;
        bank.d_weight[i] = 1.0 / most_rates;
    }
    return bank;
}

drift_bank drift_bank::stated(double rate)
{
    drift_bank bank;
    bank.d_rate[0] = rate;
    bank.d_weight[0] = 1;
    return bank;
}

void drift_bank::reset(double phase, double variance)
{
    d_mean.fill(phase);
    d_variance.fill(variance);
}

void drift_bank::turn(double by)
{
    for (auto& mean : d_mean)
        mean += by;
}

void drift_bank::widen(double variance)
{
    for (auto& own : d_variance)
        own += variance;
}

void drift_bank::predict(double seconds)
{
    for (std::size_t i = 0; i < d_count; i++)
        d_variance[i] += d_rate[i] * d_rate[i] * seconds;
}

double drift_bank::update(double phase, double noise, double memory)
{
    double most = -1e300, after = 0, kept = 0;
    std::array<double, most_rates> density;
    // The means lie close together, so that one of them says how often to wrap.
    const double first = d_mean[0], first_off = wrapped(phase - first);
    for (std::size_t i = 0; i < d_count; i++) {
        const double variance = d_variance[i] + noise,
                     off = first_off + first - d_mean[i], gain = d_variance[i] / variance;
        density[i] = log_normal(off, variance);
        most = std::max(most, density[i]);
        d_mean[i] += gain * off;
        d_variance[i] = std::max(d_variance[i] * (1 - gain), least_variance);
    }
    for (std::size_t i = 0; i < d_count; i++) {
        const double relative = std::exp(density[i] - most);
        after += d_weight[i] * relative;
        d_weight[i] = std::pow(d_weight[i], memory) * relative;
        kept += d_weight[i];
    }
    for (std::size_t i = 0; i < d_count; i++)
        d_weight[i] = std::max(d_weight[i] / kept, least_weight);
    return most + std::log(after);
}

drift_bank::moments drift_bank::estimate() const
{
    double total = 0, first = 0, second = 0;
    for (std::size_t i = 0; i < d_count; i++) {
        const double weight = d_weight[i], off = d_mean[i] - d_mean[0];
        total += weight;
        first += weight * off;
        second += weight * (d_variance[i] + off * off);
    }
    first /= total;
    return { d_mean[0] + first,
             std::max(second / total - first * first, least_variance) };
}

double drift_bank::usual_rate() const
{
    double total = 0, sum = 0;
    for (std::size_t i = 0; i < d_count; i++) {
        const double weight = d_weight[i];
        total += weight;
        sum += weight * std::log(std::max(d_rate[i], 1e-9));
    }
    return std::exp(sum / total);
}

} // namespace gr::wiforce::kernel
