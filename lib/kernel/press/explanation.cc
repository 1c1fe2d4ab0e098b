// SPDX-License-Identifier: GPL-3.0-or-later
#include "explanation.h"

#include "press_terms.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// Mean and difference of both phases, without wrapping.
pair_of_ends mean_and_difference(const pair_of_ends& phase)
{
    const double apart = wrapped(phase[0] - phase[1]);
    return { phase[1] + apart / 2, apart };
}

// Mean and difference of how far other phases lie beside these.
pair_of_ends apart_from(const pair_of_ends& phase, const pair_of_ends& other)
{
    return mean_and_difference(
        { wrapped(other[0] - phase[0]), wrapped(other[1] - phase[1]) });
}

phase_covariance of_ends(double mean, double difference, double both = 0)
{
    const double half = difference / 4;
    return { mean + half + both, mean + half - both, mean - half };
}

// A Kalman filter of one value; gives the log density that was expected of it.
double take(double& mean, double& variance, double seen, double noise)
{
    const double off = seen - mean, all = variance + noise, gain = variance / all;
    mean += gain * off;
    variance *= 1 - gain;
    return log_normal(off, all);
}

} // namespace

pair_of_ends drifting_phases::phase() const
{
    const double mean = common.estimate().mean, apart = difference.estimate().mean;
    return { mean + apart / 2, mean - apart / 2 };
}

phase_covariance drifting_phases::covariance() const
{
    return of_ends(
        common.estimate().variance, difference.estimate().variance, of_errors());
}

void drifting_phases::reset(const pair_of_ends& phase, const phase_covariance& covariance)
{
    const auto [mean, apart] = mean_and_difference(phase);
    common.reset(mean, covariance.of_mean());
    difference.reset(apart, covariance.of_difference());
    both = covariance.of_both();
}

void drifting_phases::turn(const pair_of_ends& by)
{
    const auto [mean, apart] = mean_and_difference(by);
    common.turn(mean);
    difference.turn(apart);
}

void drifting_phases::widen(const phase_covariance& by, double times)
{
    common.widen(times * by.of_mean());
    difference.widen(times * by.of_difference());
    both += times * by.of_both();
}

phase_covariance drifting_phases::with() const
{
    return of_ends(common.with(), difference.with());
}

void drifting_phases::tie(const phase_covariance& by)
{
    common.tie(by.of_mean());
    difference.tie(by.of_difference());
}

void drifting_phases::predict(double seconds)
{
    common.predict(seconds);
    difference.predict(seconds);
}

phase_covariance drifting_phases::walk(double seconds) const
{
    const auto variance = [seconds](double rate) { return rate * rate * seconds; };
    return of_ends(variance(common.usual_rate()), variance(difference.usual_rate()));
}

double drifting_phases::of_errors() const
{
    const double most =
        std::sqrt(common.estimate().variance * difference.estimate().variance);
    return std::clamp(both, -most, most);
}

// Mean and difference of phases, nearest to those of the line, with their noise, and what
// each says of the other: one end may be noisier, now as before.
drifting_phases::seen_phases drifting_phases::beside(const pair_of_ends& phase,
                                                     const phase_covariance& noise) const
{
    const auto mean = common.estimate(), apart = difference.estimate();
    const double off = wrapped(phase[0] - phase[1] - apart.mean),
                 seen_mean = phase[1] + (apart.mean + off) / 2,
                 mean_noise = noise.of_mean(), difference_noise = noise.of_difference(),
                 noises = noise.of_both(), mean_all = mean.variance + mean_noise,
                 difference_all = apart.variance + difference_noise, errors = of_errors(),
                 shared = errors + noises,
                 of_all = mean_all * difference_all - shared * shared;
    return { { seen_mean, mean_noise, { off, difference_all, errors, noises, true } },
             { apart.mean + off,
               difference_noise,
               { wrapped(seen_mean - mean.mean), mean_all, errors, noises, false } },
             errors - ((mean.variance * difference_all - errors * shared) * errors +
                       (errors * mean_all - mean.variance * shared) * apart.variance) /
                          of_all };
}

double drifting_phases::update(const pair_of_ends& phase,
                               const phase_covariance& noise,
                               double memory,
                               double lowest)
{
    const auto seen = beside(phase, noise);
    both = seen.both;
    const double most = log_normal(0, seen.difference.noise),
                 likelihood = common.update(seen.mean, memory, lowest - most);
    return likelihood < lowest - most
               ? lowest
               : likelihood + difference.update(seen.difference, memory);
}

double drifting_phases::carry(drifting_phases& line,
                              const pair_of_ends& phase,
                              const phase_covariance& noise,
                              double memory)
{
    const auto seen = beside(phase, noise);
    both = seen.both;
    return common.carry(line.common, seen.mean, memory) +
           difference.carry(line.difference, seen.difference, memory);
}

void drifting_phases::merge(const drifting_phases& other, double share)
{
    const double mean_apart =
                     wrapped(other.common.estimate().mean - common.estimate().mean),
                 apart = wrapped(other.difference.estimate().mean -
                                 difference.estimate().mean);
    mix_covariance(both, other.both, mean_apart, apart, share);
    common.merge(other.common, share);
    difference.merge(other.difference, share);
}

void both_amplitudes::merge(const both_amplitudes& other, double share)
{
    mix_moments(mean, mean_variance, other.mean - mean, other.mean_variance, share);
    mix_moments(difference,
                difference_variance,
                other.difference - difference,
                other.difference_variance,
                share);
}

both_ends both_amplitudes::at(const pair_of_ends& phase) const
{
    const auto own = ends();
    return { std::polar(std::exp(own[0]), phase[0]),
             std::polar(std::exp(own[1]), phase[1]) };
}

void both_amplitudes::grow(const pair_of_ends& by)
{
    mean += (by[0] + by[1]) / 2;
    difference += by[0] - by[1];
}

double both_amplitudes::update_difference(double seen, double noise)
{
    return take(difference, difference_variance, seen, noise);
}

double both_amplitudes::update_mean(double seen, double noise)
{
    return take(mean, mean_variance, seen, noise);
}

void average_of_groups::recount(const pair_of_ends& by, const pair_of_ends& gain)
{
    for (int e = 0; e < 2; e++) {
        phase[e] += by[e];
        amplitude[e] += gain[e];
    }
}

double explanation::tag_turn::deviation() const
{
    return age_s == 0 ? turn_speeds[speed] : std::abs(velocity) / 2;
}

pair_of_ends explanation::change(const pair_of_ends& phase) const
{
    const auto at = line.phase();
    return { phase[0] - at[0], phase[1] - at[1] };
}

void explanation::recount(const pair_of_ends& phase, const pair_of_ends& gain)
{
    line.turn(phase);
    press.held.turn(phase);
    press.motion.turn(phase);
    line.amplitude.grow(gain);
    press.strength.grow(gain);
    mean.recount(phase, gain);
    if (is == mixed)
        for (int e = 0; e < 2; e++)
            for (auto* ends : { &mixture.start, &mixture.seen })
                (*ends)[e] *= std::polar(std::exp(gain[e]), phase[e]);
}

pair_of_ends press_outcome::apart(const press_outcome& other) const
{
    return apart_from(baseline, other.baseline);
}

pair_of_ends press_outcome::seen_apart(const press_outcome& other) const
{
    return apart_from(mean.phase, other.mean.phase);
}

void press_outcome::merge(const press_outcome& other, double share)
{
    const auto [common, difference] = apart(other);
    double turned = 0, parted = 0;
    mix_covariance(covariance, other.covariance, common, difference, share);
    mix_moments(turned, common_variance, common, other.common_variance, share);
    mix_moments(
        parted, difference_variance, difference, other.difference_variance, share);
    baseline[0] += turned + parted / 2;
    baseline[1] += turned - parted / 2;
    for (int e = 0; e < 2; e++)
        amplitude[e] += share * (other.amplitude[e] - amplitude[e]);
    turns += share * (other.turns - turns);
    in_part += share * (other.in_part - in_part);
}

void press_outcome::recount(const pair_of_ends& phase, const pair_of_ends& gain)
{
    for (int e = 0; e < 2; e++) {
        baseline[e] += phase[e];
        amplitude[e] += gain[e];
    }
    mean.recount(phase, gain);
}

// By moments: mean and covariance of both.
void explanation::merge(const explanation& other, double share)
{
    const auto mean = [share](double& own, double others) {
        own += share * (others - own);
    };
    const double line_apart = wrapped(other.line.common.estimate().mean -
                                      line.common.estimate().mean),
                 strength_apart =
                     other.press.strength.difference - press.strength.difference;
    mix_covariance(
        press.with_common, other.press.with_common, line_apart, strength_apart, share);
    line.merge(other.line, share);
    line.amplitude.merge(other.line.amplitude, share);
    press.held.merge(other.press.held, share);
    press.motion.merge(other.press.motion, share);
    press.strength.merge(other.press.strength, share);
    mean(age_s, other.age_s);
    for (auto part : { &tag_turn::velocity,
                       &tag_turn::age_s,
                       &tag_turn::seen,
                       &tag_turn::hands,
                       &tag_turn::moved,
                       &tag_turn::failed,
                       &tag_turn::bursts,
                       &tag_turn::watched_s })
        mean(turn.*part, other.turn.*part);
    mean(mixture.age_s, other.mixture.age_s);
    mixture.log_density = -std::log((1 - share) * std::exp(-mixture.log_density) +
                                    share * std::exp(-other.mixture.log_density));
    for (int e = 0; e < 2; e++)
        mixture.start[e] += share * (other.mixture.start[e] - mixture.start[e]);
    now.merge(other.now, share);
    last.merge(other.last, share);
    log_weight -= std::log1p(-share);
}

} // namespace gr::wiforce::kernel
