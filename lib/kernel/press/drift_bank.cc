// SPDX-License-Identifier: GPL-3.0-or-later
#include "drift_bank.h"

#include "press_terms.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace gr::wiforce::kernel {

namespace {

// rad per sqrt(s): from what nobody notices in a minute, .003 degrees, to what hides a
// press in a second, 3 degrees.
constexpr double rates[drift_bank::most_rates] = { 0.003 * deg, 0.03 * deg, 0.1 * deg,
                                                   0.3 * deg,   1.0 * deg,  3.0 * deg };
const auto log_rates = [] {
    std::array<double, drift_bank::most_rates> logs;
    std::transform(std::begin(rates), std::end(rates), logs.begin(), [](double r) {
        return std::log(r);
    });
    return logs;
}();
constexpr double least_variance = 1e-14;
// A rate that seemed impossible may return.
constexpr double least_share = 1e-100;

} // namespace

drift_bank::drift_bank(double scale, double stated) : d_scale(scale)
{
    if (stated >= 0) {
        d_usual_rate = scale * stated;
        d_scale = d_usual_rate / rates[0];
    } else {
        d_count = most_rates;
        d_weight.fill(1.0 / most_rates);
    }
}

void drift_bank::reset(double phase, double variance)
{
    d_mean.fill(phase);
    d_variance.fill(variance);
    d_with.fill(0);
    d_carried = d_farthest2 = 0;
    d_estimate = { phase, std::max(variance, least_variance) };
}

void drift_bank::turn(double by)
{
    for (auto& mean : d_mean)
        mean += by;
    d_estimate.mean += by;
}

void drift_bank::widen(double variance)
{
    for (auto& own : d_variance)
        own = std::max(own + variance, least_variance);
    d_estimate.variance = std::max(d_estimate.variance + variance, least_variance);
}

void drift_bank::narrow(double ratio)
{
    const double closer = std::sqrt(ratio);
    for (std::size_t i = 0; i < d_count; i++) {
        d_mean[i] = d_estimate.mean + closer * (d_mean[i] - d_estimate.mean);
        d_variance[i] = std::max(ratio * d_variance[i], least_variance);
    }
    summarize();
}

// By the weights of the rates, which add up to one.
double drift_bank::mean_of(const std::array<double, most_rates>& each) const
{
    double sum = 0;
    for (std::size_t i = 0; i < d_count; i++)
        sum += d_weight[i] * each[i];
    return sum;
}

double drift_bank::with() const { return mean_of(d_with); }

void drift_bank::tie(double variance)
{
    for (auto& with : d_with)
        with += variance;
}

void drift_bank::predict(double seconds)
{
    for (std::size_t i = 0; i < d_count; i++) {
        const double rate = d_scale * rates[i], walks = rate * rate * seconds;
        d_variance[i] += walks;
        d_with[i] += walks / 2;
    }
    find_usual_rate();
    summarize();
}

void drift_bank::merge(const drift_bank& other, double share)
{
    for (std::size_t i = 0; i < d_count; i++) {
        const double own = (1 - share) * d_weight[i], others = share * other.d_weight[i],
                     apart = wrapped(other.d_mean[i] - d_mean[i]);
        d_weight[i] = own + others;
        d_with[i] += others / d_weight[i] * (other.d_with[i] - d_with[i]);
        mix_moments(
            d_mean[i], d_variance[i], apart, other.d_variance[i], others / d_weight[i]);
    }
    d_carried += share * (other.d_carried - d_carried);
    d_farthest2 += share * (other.d_farthest2 - d_farthest2);
    summarize();
}

// The errors of each rate are correlated with those of the companion as those of all.
drift_bank::correction drift_bank::correct(std::size_t rate,
                                           double off,
                                           double noise,
                                           const companion& beside) const
{
    const double own = d_variance[rate],
                 errors = beside.errors * std::sqrt(own / d_estimate.variance),
                 both = errors + beside.noise, shared = both / beside.variance,
                 variance = own + noise - shared * both;
    return { off - shared * beside.off,
             variance,
             (own - shared * errors) / variance,
             errors / beside.variance };
}

double drift_bank::carry(drift_bank& other, const observation& seen, double memory)
{
    const double was = other.d_estimate.mean;
    for (std::size_t i = 0; i < d_count; i++) {
        const auto own =
            correct(i, wrapped(seen.phase - d_mean[i]), seen.noise, seen.beside);
        const double others = d_with[i] / own.variance;
        other.d_mean[i] += others * own.off;
        other.d_variance[i] =
            std::max(other.d_variance[i] - others * d_with[i], least_variance);
        d_with[i] -= own.gain * d_with[i];
    }
    const double likelihood = update(seen, memory);
    other.d_weight = d_weight;
    other.summarize();
    d_carried += other.d_estimate.mean - was;
    const double farther2 = std::max(d_carried * d_carried, d_farthest2);
    other.widen((farther2 - d_farthest2) / 2);
    d_farthest2 = farther2;
    return likelihood;
}

double drift_bank::update(const observation& seen, double memory, double lowest)
{
    const auto& [phase, noise, beside] = seen;
    double least = 1e300, after = 0, kept = 0;
    std::array<double, most_rates> square, relative;
    // The means lie close together, so that one of them says how often to wrap.
    const double first = d_mean[0], first_off = wrapped(phase - first);
    for (std::size_t i = 0; i < d_count; i++) {
        const double off = first_off + first - d_mean[i];
        const auto own = correct(i, off, noise, beside);
        const double expected = beside.known ? own.variance : d_variance[i] + noise;
        square[i] = squared(beside.known ? own.off : off) / expected;
        relative[i] = 1 / std::sqrt(expected);
        least = std::min(least, square[i]);
        d_mean[i] += own.gain_of_companion * beside.off + own.gain * own.off;
        d_variance[i] =
            std::max(d_variance[i] - squared(own.gain_of_companion) * beside.variance -
                         squared(own.gain) * own.variance,
                     least_variance);
    }
    for (std::size_t i = 0; i < d_count; i++) {
        relative[i] *= std::exp((least - square[i]) / 2);
        after += d_weight[i] * relative[i];
    }
    const double likelihood = std::log(after) - (least + std::log(two_pi)) / 2;
    if (likelihood < lowest)
        return likelihood;
    for (std::size_t i = 0; i < d_count; i++) {
        d_weight[i] = std::pow(d_weight[i], memory) * relative[i];
        kept += d_weight[i];
    }
    for (std::size_t i = 0; i < d_count; i++)
        d_weight[i] = std::max(d_weight[i] / kept, least_share);
    summarize();
    return likelihood;
}

void drift_bank::summarize()
{
    double first = 0, second = 0;
    for (std::size_t i = 0; i < d_count; i++) {
        const double off = d_mean[i] - d_mean[0];
        first += d_weight[i] * off;
        second += d_weight[i] * (d_variance[i] + off * off);
    }
    d_estimate = { d_mean[0] + first, std::max(second - first * first, least_variance) };
}

void drift_bank::find_usual_rate()
{
    if (d_count > 1)
        d_usual_rate = d_scale * std::exp(mean_of(log_rates));
}

} // namespace gr::wiforce::kernel
