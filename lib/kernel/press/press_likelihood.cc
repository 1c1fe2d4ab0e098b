// SPDX-License-Identifier: GPL-3.0-or-later
// Parts of the events: how phases and amplitudes of a line and of a press are predicted.
#include "press_filter.h"
#include "press_terms.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

constexpr double least_variance = 1e-12; // of a contact's loss, Np^2

} // namespace

// No event predicts a group better than its noise, and what contacts look like, allow.
void press_filter::find_peaks()
{
    d_amplitude_peak = std::max(log_normal(0, d_seen.mean_variance), 0.0) +
                       log_normal(0, d_seen.difference_variance);
    d_peak = std::max(phase_peak({}), d_contact_peak);
}

// Largest log density of phases that an event widens by this.
double press_filter::phase_peak(const phase_covariance& by) const
{
    const double first = d_noise.first + by.first, second = d_noise.second + by.second,
                 both = d_noise.both + by.both;
    return -std::log(two_pi) - std::log(first * second - both * both) / 2;
}

// Whether one may keep a weight that predicts the phases so well.
bool press_filter::may_count(const explanation& next, double log_phases) const
{
    return log_phases > least_phases(next);
}

double press_filter::least_phases(const explanation& next) const
{
    return d_best + d_negligible - d_amplitude_peak - next.log_weight;
}

// Adds what follows, for the event to change and to give; nothing where it cannot count,
// as the phases are predicted no better than this.
explanation*
press_filter::follow(const explanation& from, double probability, double phase_peak)
{
    const double log_probability = std::log(probability);
    if (!may_count(from, log_probability + std::min(phase_peak, d_peak)))
        return nullptr;
    auto& next = d_next.emplace_back(from);
    next.log_weight += log_probability;
    next.claimed = false;
    next.in_part = 0;
    return &next;
}

// Completes the newest of what follows, or drops it.
void press_filter::give(explanation& next, double log_likelihood, bool lasts)
{
    next.log_weight += log_likelihood;
    if (!(next.log_weight > d_best + d_negligible)) {
        d_next.pop_back();
        return;
    }
    d_best = std::max(d_best, next.log_weight);
    next.turn.failed += d_silent ? 0 : next.in_part;
    average(next, lasts);
    next.last = next.now;
    next.now = describe(next);
}

// Mean of the groups for as long as nothing changes: of as many as last smoothing_s.
void press_filter::average(explanation& to, bool lasts) const
{
    auto& mean = to.mean;
    const double x = d_set.smoothing_s > 0 ? d_elapsed_s / d_set.smoothing_s : 1;
    const double kept = lasts ? std::max(0.0, (1 - x) / (1 + x)) : 0;
    for (int e = 0; e < 2; e++) {
        const double noise = d_group.variance[e], weight = kept * mean.weight[e],
                     gain = 1 / (1 + weight * noise);
        mean.phase[e] =
            d_group.phase[e] + (1 - gain) * wrapped(mean.phase[e] - d_group.phase[e]);
        mean.amplitude[e] += gain * (d_group.amplitude[e] - mean.amplitude[e]);
        mean.variance[e] = squared(gain) * noise + squared(1 - gain) * mean.variance[e];
        mean.weight[e] = weight + 1 / noise;
    }
}

// Steps have any size of four decades, in equal parts per octave.
const double step_span = std::log(1e4);

double press_filter::step_probability() const
{
    if (d_group.retuned)
        return 1;
    const double variance = d_group.receiver_variance;
    const double prior = happens(d_set.steps);
    const double size2 =
        squared(d_group.receiver_phase) + squared(d_group.receiver_amplitude) + variance;
    const double log_step =
                     std::log(prior + 1e-300) - std::log(two_pi * size2 * step_span),
                 log_none = log_normal(d_group.receiver_phase, variance) +
                            log_normal(d_group.receiver_amplitude, variance);
    const double steps = 1 / (1 + std::exp(std::min(log_none - log_step, 700.0)));
    return steps < 1e-7 ? 0 : steps > 1 - 1e-7 ? 1 : steps;
}

void press_filter::step_receiver(explanation& to) const
{
    const bool unknown = d_group.retuned;
    const double by = unknown ? 0 : d_group.receiver_phase,
                 gain = unknown ? 0 : d_group.receiver_amplitude,
                 variance = unknown ? unknown_phase : 2 * d_group.receiver_variance;
    to.recount({ by, by }, { gain, gain });
    to.line.common.widen(variance);
    to.press.held.common.widen(variance);
    to.press.held.common.tie(variance);
    to.press.motion.widen({ variance, variance, variance });
    to.line.amplitude.mean_variance += variance;
    to.press.strength.mean_variance += variance;
    if (unknown)
        to.mean.weight = {};
}

// Lets the tag's level step, as the receiver's may, to what is seen: between two groups,
// or in the one before, which it has made a mixed one.
void press_filter::step_level(const explanation& from)
{
    const auto was = from.touched() ? shown_strength(from) : from.line.amplitude;
    const double by = d_seen.mean - was.mean,
                 variance = was.mean_variance + d_seen.mean_variance;
    if (squared(by) <= variance) // no step is as likely as none
        return;
    const double prior = happens(d_set.steps) * (from.is == mixed ? 1 : between_groups()),
                 log_step = std::log(prior + 1e-300) -
                            std::log(2 * std::sqrt(squared(by) + variance) * step_span);
    if (log_step < log_normal(by, variance))
        return;
    const double log_probability = log_step - log_normal(0, variance);
    if (!may_count(from, log_probability + d_peak))
        return;
    auto stepped = from;
    stepped.recount({}, { by, by });
    stepped.mixture = from.mixture; // was seen before the step
    stepped.log_weight += log_probability;
    branch(stepped);
}

void press_filter::reset_baseline(explanation& to) const
{
    to.line.reset(d_group.phase, d_noise);
    to.line.amplitude = d_seen;
}

void press_filter::drift(explanation& to) const
{
    to.press.motion.widen(to.line.walk(d_elapsed_s));
}

double press_filter::rate_memory() const
{
    return std::max(0.0, 1 - d_elapsed_s / d_set.drift_memory_s);
}

double press_filter::update_baseline(explanation& to) const
{
    const double phases =
        to.line.update(d_group.phase, d_noise, rate_memory(), least_phases(to));
    if (!may_count(to, phases))
        return lost;
    return phases + update_amplitude(to, to.line.amplitude);
}

// Log density of the phases of a contact that begins in this group.
double press_filter::contact_phases(const explanation& of) const
{
    if (!of.line.known)
        return log_any_phases;
    const double explained = density(of, d_group.phase);
    if (of.is == pressed)
        return log_density(explained);
    double near = 0;
    const auto at = of.line.phase();
    for (int e = 0; e < 2; e++)
        near += squared(wrapped(d_group.phase[e] - at[e]) / (least_contact_deg * deg));
    near = 0.99 * std::exp(-squared(near) / 2);
    return log_any_phases - std::log1p(explained / outside) + std::log1p(-near);
}

// Amplitudes of a contact that begins in this group.
double press_filter::find_strength(explanation& to, double spread) const
{
    const auto with_loss = [&](double loss, both_amplitudes& own) {
        own = to.line.amplitude;
        own.mean_variance += squared(loss) / 2;
        own.difference_variance += 2 * squared(loss);
        return update_amplitude(to, own);
    };
    const double some = with_loss(spread, to.press.strength), in_part = to.in_part;
    // Good contacts lose nothing.
    both_amplitudes good;
    const double none = with_loss(0, good), either = log_sum(some, none);
    if (none > some)
        to.press.strength = good;
    to.in_part += std::exp(some - either) * (in_part - to.in_part);
    return either - std::log(2.0);
}

// What turns, turns by no more in a group than a sudden turn does.
double press_filter::turning_speed(std::size_t speed) const
{
    return std::min(turn_speeds[speed], d_set.turn_deg * deg / d_elapsed_s);
}

// By which a hand that moves at one of the speeds changes amplitudes, as it does phases:
// it adds a phasor of any angle.
double press_filter::hand_variance(std::size_t speed) const
{
    return squared(turning_speed(speed)) * d_elapsed_s *
           std::max(d_elapsed_s, least_hand_s);
}

double press_filter::update_amplitude(explanation& of, both_amplitudes& own) const
{
    const auto seen = seen_beside(caused_by_off(of, d_group.phase));
    const double likelihood = update_mean(of, own, seen.mean);
    return likelihood + own.update_difference(seen.difference, seen.difference_variance);
}

// As far as the tag was received: where its supply has failed, both amplitudes are those
// of any share of the group.
double press_filter::update_mean(explanation& of, both_amplitudes& own, double seen) const
{
    const double off = seen - own.mean, above = std::max(off, 0.0);
    const double part = of.log_fails + off - above -
                        squared(above) / 2 / (own.mean_variance + d_seen.mean_variance);
    auto taken = own;
    const double all = of.log_works + taken.update_mean(seen, d_seen.mean_variance);
    if (all > part)
        own = taken;
    of.in_part = 1 / (1 + std::exp(all - part));
    return log_sum(all, part);
}

// Amplitudes of a press at these phases, by the off states.
pair_of_ends press_filter::caused_by_off(const explanation& of,
                                         const pair_of_ends& phase) const
{
    return of.touched() && of.line.known ? d_off.amplitude(of.change(phase))
                                         : pair_of_ends{};
}

// Whether the amplitudes show how far both ends have turned.
bool press_filter::shows_turns(const explanation& of) const
{
    return of.is != untouched && learns_turns(of);
}

// Whether a turn looks like nothing else in this state, so that its rate is learned.
bool press_filter::learns_turns(const explanation& of) const
{
    return of.is == untouched || (d_off_differ && of.line.known && of.is != mixed);
}

// Takes the amplitudes of a press whose phases are predicted so well; gives the log
// density of both.
double press_filter::update_strength(explanation& to, double log_phases) const
{
    if (!may_count(to, log_phases))
        return lost;
    return log_phases + (shows_turns(to) ? update_from_off_states(to)
                                         : update_amplitude(to, to.press.strength));
}

// Likewise where what turns the tag changes the amplitudes of the press and of the line,
// by these variances of their mean and their difference.
double press_filter::update_strength_while_turning(explanation& to,
                                                   double log_phases,
                                                   const pair_of_ends& variances) const
{
    auto& own = to.press.strength;
    const auto before = own;
    own.widen(variances);
    const double likelihood = update_strength(to, log_phases);
    to.line.amplitude.mean += own.mean - before.mean;
    if (variances[1] > 0)
        to.line.amplitude.difference += own.difference - before.difference;
    return likelihood;
}

// Where the off states differ the amplitudes show the common phase, as far as is known
// what the contact loses: a Kalman filter of both, which are correlated from then on. A
// large turn bends what is seen, so that it is linearized again where the first pass
// leads.
double press_filter::update_from_off_states(explanation& to) const
{
    auto& own = to.press.strength;
    const double known = to.line.common.estimate().variance;
    const auto seen = to.change(d_group.phase);
    both_amplitudes by_contact;
    double turned = 0, off, variance, by_turn, by_loss;
    bool again = false;
    do {
        const pair_of_ends change{ seen[0] - turned, seen[1] - turned };
        by_contact = seen_beside(d_off.amplitude(change));
        const double slope = -d_off.slope(change);
        variance = slope * slope * known + 2 * slope * to.press.with_common +
                   own.difference_variance + by_contact.difference_variance;
        by_turn = (slope * known + to.press.with_common) / variance;
        by_loss = (slope * to.press.with_common + own.difference_variance) / variance;
        off = by_contact.difference - own.difference + slope * turned;
        turned = by_turn * off;
        again = !again && std::abs(turned) > deg;
    } while (again);
    own.difference += by_loss * off;
    own.difference_variance =
        std::max(own.difference_variance - squared(by_loss) * variance, least_variance);
    to.press.with_common -= by_turn * by_loss * variance;
    to.line.common.turn(turned);
    const double ratio = std::max(1 - squared(by_turn) * variance / known, 1e-6);
    to.line.common.narrow(ratio);
    to.press.held.common.tie((ratio - 1) * to.press.held.common.with());
    return log_normal(off, variance) + update_mean(to, own, by_contact.mean);
}

// Of a contact that loses something, or nothing, where the off states differ. A press is
// one resistance that both ends see.
double press_filter::begin_strength(explanation& to, double spread) const
{
    auto& own = to.press.strength;
    own = to.line.amplitude;
    to.press.with_common = 0;
    own.mean_variance += squared(spread) / 2;
    own.difference_variance += d_off.variance(to.change(d_group.phase));
    return update_from_off_states(to);
}

both_amplitudes press_filter::shown_strength(const explanation& of) const
{
    auto seen = of.press.strength;
    seen.grow(caused_by_off(of, of.press.motion.phase()));
    return seen;
}

void press_filter::begin_press(explanation& to) const
{
    to.press.steady = false;
    to.press.motion.hold(d_group.phase, d_noise);
    to.press.held = to.line;
    to.hold_level();
}

// Of a press of which nothing but this group is known.
void press_filter::reset_strength(explanation& to) const
{
    to.press.strength = seen_beside(caused_by_off(to, d_group.phase));
    to.press.with_common = 0;
}

// Of this group, without what something else has caused.
both_amplitudes press_filter::seen_beside(const pair_of_ends& caused) const
{
    auto seen = d_seen;
    seen.grow({ -caused[0], -caused[1] });
    return seen;
}

double press_filter::density(const explanation& of, const pair_of_ends& phase) const
{
    const double variance = of.line.common.estimate().variance;
    const auto changed = of.change(phase);
    const double middle = d_image->density(changed);
    if (variance < squared(deg))
        return middle;
    // Gauss-Hermite quadrature over the common phase.
    const double away = std::sqrt(3 * std::min(variance, 1.0));
    return 2.0 / 3 * middle +
           (d_image->density({ changed[0] - away, changed[1] - away }) +
            d_image->density({ changed[0] + away, changed[1] + away })) /
               6;
}

// Log density of a mixture of the state before and the one after, over that of any
// mixture; the latter itself has this share.
double press_filter::chord(
    const mixture& from, const both_ends& to, state after, double variance, double any)
{
    const double level2 = (std::norm(from.start[0]) + std::norm(from.start[1])) / 2,
                 noise = (from.seen_variance + variance / 4) * level2;
    double length2 = 0, around = 0, along = 0;
    both_ends step, seen;
    for (int e = 0; e < 2; e++) {
        step[e] = to[e] - from.start[e];
        seen[e] = from.seen[e] - from.start[e];
        length2 += std::norm(step[e]);
        around += std::norm(step[e]) - squared(std::abs(to[e]) - std::abs(from.start[e]));
        along += (std::conj(step[e]) * seen[e]).real();
    }
    const double share = std::clamp(along / std::max(length2, 1e-12), 0.0, 1.0);
    double off = 0;
    for (int e = 0; e < 2; e++)
        off += std::norm(seen[e] - share * step[e]);
    // Three degrees of freedom lie across the chord. A change takes a part of the group
    // and its phases follow the circle, so that its mean lies beside the chord; and the
    // force may have changed before the press ended, or after it began, for as long as it
    // lasted.
    const double beside = noise + squared(around * share * (1 - share) / 4) / level2,
                 is_pressed = (from.before == untouched ? 0 : 1 - share) +
                              (after == untouched ? 0 : share),
                 ramped = beside + squared(is_pressed * ramp_deg * deg) * level2;
    const auto across = [&](double v) {
        return std::exp(-0.5 * off / v) / (two_pi * v * std::sqrt(two_pi * v));
    };
    const double on = (1 - any_share) / 2 * (across(beside) + across(ramped)) /
                      (std::sqrt(length2) + 3 * std::sqrt(noise));
    // Over phases and logarithms of amplitudes, as that of any mixture.
    const double area = std::norm(from.seen[0] * from.seen[1]);
    return std::log(on * area * std::exp(-log_any_mixture) + any);
}

// Where what comes after is the untouched line.
double press_filter::chord_to_line(const mixture& from, const explanation& of, double any)
{
    return chord(
        from, of.line.ratio(), untouched, of.line.common.estimate().variance, any);
}

// Log density, over that of any mixture, of a press for a part of a group that was
// untouched before: z = 1 - s + s e^{j phi} at both ends, so that each shows its share s
// and phi of the press.
double press_filter::pressed_in_part(const mixture& from) const
{
    std::array<double, 2> share;
    double variance = 0, log_area = 0;
    for (int e = 0; e < 2; e++) {
        const auto z = from.seen[e] / from.start[e], a = 1.0 - z;
        const double noise = from.seen_variance;
        if (a.real() < 3 * std::sqrt(noise))
            return 0;
        share[e] = std::norm(a) / (2 * a.real());
        variance +=
            noise * (squared(1 - share[e] / a.real()) + squared(a.imag() / a.real()));
        log_area += std::log(a.real()) - std::log(std::norm(z));
    }
    const double s = (share[0] + share[1]) / 2;
    if (s > 1 + 3 * std::sqrt(variance))
        return 0;
    pair_of_ends change;
    for (int e = 0; e < 2; e++)
        change[e] = std::arg(from.seen[e] / from.start[e] - (1 - s));
    const double here = log_density(d_image->density(change)) - log_area +
                        log_normal(share[0] - share[1], variance) - log_any_mixture;
    return log_sum(std::log1p(-any_share) + here, std::log(any_share));
}

// Density of the image where a press is, and the direction in which more force moves it.
void press_filter::look_up(explanation& of) const
{
    auto& press = of.press;
    press.heading = {};
    press.log_density = 0;
    if (of.before_change() != pressed || !of.line.known)
        return;
    const auto phase = press.motion.phase();
    press.heading = d_image->direction(of.change(phase));
    press.log_density = log_density(density(of, phase));
}

// What a press that changes gains of the image: in the end its density is that of the
// phases there, as of a contact.
double press_filter::density_gained(explanation& to, const explanation& from) const
{
    look_up(to);
    return to.press.log_density - from.press.log_density;
}

// Of a press that slides, or rolls, any; a force moves both phases in the direction of
// the image, beside which it goes by the same angle for as long as the press changes.
press_image::heading press_filter::heading_of(const explanation& of, bool slides) const
{
    if (slides)
        return {};
    auto found = of.press.heading;
    double aside = squared(d_set.aside);
    if (of.press.steady) {
        const auto [x, y] = found.along;
        const auto velocity = of.press.motion.velocity();
        const double first = velocity[0] - of.turn.rate(),
                     second = velocity[1] - of.turn.rate();
        const auto error = of.press.motion.velocity_covariance();
        const double along = x * first + y * second, across = x * second - y * first,
                     variance = x * x * error.second + y * y * error.first -
                                2 * x * y * error.both + found.variance * squared(along),
                     all = aside * squared(along) + variance,
                     tangent = aside * along * across / all,
                     length = std::sqrt(1 + squared(tangent));
        found.along = { (x - tangent * y) / length, (y + tangent * x) / length };
        aside *= variance / all;
    }
    found.variance += aside;
    return found;
}

// What a force moves goes on along the image, as far as this is known to bend.
void press_filter::bend(explanation& to, const press_image::heading& was) const
{
    const auto& is = to.press.heading;
    const auto &from = was.along, &at = is.along;
    const double aside = squared(d_set.aside),
                 known = aside / (aside + was.variance + is.variance),
                 angle = std::atan2(from[0] * at[1] - from[1] * at[0],
                                    from[0] * at[0] + from[1] * at[1]);
    to.press.motion.bend(known * angle, to.turn.rate());
}

press_filter::outcome press_filter::describe(const explanation& of) const
{
    const auto common = of.line.common.estimate(), apart = of.line.difference.estimate();
    // What turns an untouched sensor steadily is followed, and off states show by how
    // much a touched one has turned; not what has moved one of its ends.
    const bool steadily = of.turn.goes_on && of.is != untouched &&
                          (of.turn.by_hand || of.turn.speed > slow_turn),
               turns =
                   of.turn.parted || ((of.turn.sudden || steadily) && !shows_turns(of));
    return { 0,
             0,
             of.is,
             of.line.known,
             turns ? 1.0 : 0.0,
             of.in_part,
             of.line.phase(),
             of.line.amplitude.ends(),
             common.variance,
             apart.variance,
             of.line.of_errors(),
             of.mean };
}

} // namespace gr::wiforce::kernel
