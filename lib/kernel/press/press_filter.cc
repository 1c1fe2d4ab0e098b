// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_filter.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// Explanations that are kept, and logarithms of weights that count: of 1e-8.
constexpr std::size_t most_kept = 16;
constexpr double negligible = -18;
constexpr double deg = two_pi / 360;
// Speeds of steady changes, rad/s: a force that creeps, rises, is applied quickly, is a
// tap.
constexpr std::array<double, 4> speeds{ 5 * deg, 50 * deg, 500 * deg, 3000 * deg };
constexpr std::size_t turning_speeds = 3, near_speeds = 2; // of tags, and of hands nearby
// Turns keep their speed for about so long.
constexpr double least_turn_s = 0.05;
// A change has no other time to happen in than the group: part of the time, at most.
constexpr double surest_change = 0.8;
// Part of sudden changes that happen between two groups.
constexpr double at_border = 0.1;
// Contacts change the phases by more.
constexpr double least_contact_deg = 10;
// By how much a press at one location changes the phases, at once.
constexpr double jump_deg = 10, least_jump_deg = 2;
// Presses that slide, of those that change steadily.
constexpr double sliding = 0.2;
// Change of the phases by the force in a group in which a press begins or ends.
constexpr double ramp_deg = 4;
// Density per rad^2 below which the model does not contain a press.
constexpr double outside = 0.003;
// Variance of a phase of which nothing is known, rad^2.
constexpr double unknown_phase = two_pi * two_pi / 12;
// Spread of amplitudes of contacts that the model does not contain, Np.
constexpr double any_amplitude = 0.3;

double log_sum(double a, double b)
{
    return a > b ? a + std::log1p(std::exp(b - a)) : b + std::log1p(std::exp(a - b));
}

double squared(double x) { return x * x; }

// Of phases and amplitudes that may be anything.
const double log_any_phases = -2 * std::log(two_pi);
const double log_any_mixture = log_any_phases - 2 * std::log(0.7);

// Of both ends, whose mean and difference these are.
pair_of_ends phases_of(const drift_bank& common, const drift_bank& difference)
{
    const double mean = common.estimate().mean, apart = difference.estimate().mean;
    return { mean + apart / 2, mean - apart / 2 };
}

phase_covariance covariance_of(const drift_bank& common, const drift_bank& difference)
{
    const double mean = common.estimate().variance,
                 apart = difference.estimate().variance / 4;
    return { mean + apart, mean + apart, mean - apart };
}

const pair_of_ends alike_both{ std::sqrt(0.5), std::sqrt(0.5) };

} // namespace

press_filter::press_filter(std::shared_ptr<const press_image> image,
                           const press_parameters& settings)
    : d_image(std::move(image)), d_set(settings)
{
}

void press_filter::take(const press_observation& group)
{
    d_elapsed_s = d_kept.empty() ? 0 : group.time_s - d_group.time_s;
    d_group = group;
    const auto& noise = group.variance;
    const double floor = squared(d_set.phase_deg * deg);
    d_noise = { noise[0] + floor + group.common_variance,
                noise[1] + floor + group.common_variance,
                group.common_variance };
    d_difference_noise = noise[0] + noise[1] + 2 * floor;
    d_common_noise = d_difference_noise / 4 + group.common_variance;
    d_amplitude_noise = (noise[0] + noise[1]) / 4 + squared(d_set.amplitude_np) / 2;
    d_amplitude = (group.amplitude[0] + group.amplitude[1]) / 2;
    d_amplitude_difference = group.amplitude[0] - group.amplitude[1];
    d_peak = log_normal(0, d_common_noise) + log_normal(0, d_difference_noise) +
             log_normal(0, d_amplitude_noise) + log_normal(0, 4 * d_amplitude_noise);
    d_next.clear();
    d_best = -1e300;
    if (d_kept.empty())
        start(group);
    const double steps = step_probability();
    for (auto& from : d_kept) {
        from.common.predict(d_elapsed_s);
        from.difference.predict(d_elapsed_s);
        from.held_common.predict(d_elapsed_s);
        from.held_difference.predict(d_elapsed_s);
        from.line.mean_variance += squared(d_set.fading_np) * d_elapsed_s;
        from.strength.mean_variance += squared(d_set.fading_np) * d_elapsed_s;
        from.age_s += d_elapsed_s;
        from.turned_now = false;
        from.untouched_s += from.is == untouched ? d_elapsed_s : 0;
        const double log_weight = from.log_weight;
        if (steps < 1) {
            from.log_weight = log_weight + std::log1p(-steps);
            branch(from);
        }
        if (steps > 0) {
            from.log_weight = log_weight + std::log(steps);
            step_receiver(from);
            branch(from);
        }
    }
    settle();
}

void press_filter::start(const press_observation& group)
{
    const double rate = d_set.drift_deg * deg;
    const bool stated = d_set.drift_deg >= 0;
    // Both ends drift by themselves: their mean by less, their difference by more.
    const double mean = std::sqrt(0.5), apart = std::sqrt(2.0);
    explanation first;
    first.common = stated ? drift_bank::stated(rate * mean) : drift_bank::learning(mean);
    first.difference =
        stated ? drift_bank::stated(rate * apart) : drift_bank::learning(apart);
    reset_baseline(first);
    const double sure = group.untouched > 0 ? group.untouched : 0.5;
    first.log_weight = std::log(sure);
    give(first, 0);
    // A press that began before the first group: the untouched line is unknown.
    auto touched = first;
    touched.is = pressed;
    touched.known = false;
    touched.log_weight = std::log1p(-sure);
    begin_press(touched);
    give(touched, 0);
}

// ---- what may have happened

void press_filter::branch(const explanation& from)
{
    if (from.is == mixed)
        branch_mixed(from);
    else if (from.is == untouched)
        branch_untouched(from);
    else
        branch_touched(from);
}

namespace {

// Probabilities of the changes of a state of this age, in the time of a group.
struct changes {
    double all, unexplained, press, release, exchange, jump, steadily;

    changes(double age_s, double elapsed_s, double doubt, const press_parameters& set)
    {
        all = doubt * std::min(surest_change, elapsed_s / (age_s + set.settling_s));
        unexplained = set.unexplained * all;
        press = all - unexplained;
        release = set.release * all;
        exchange = set.exchange * all;
        jump = set.jump * all;
        steadily = std::max(all - release - exchange - jump - unexplained, 0.0);
    }
};

} // namespace

void press_filter::branch_untouched(const explanation& from)
{
    const changes may(from.age_s, d_elapsed_s, 1 - d_group.untouched, d_set);
    const double turns = turn_probability(from), goes_on = going_on(),
                 hands = -std::expm1(-d_set.hands * d_elapsed_s);
    const double sudden = may.all + turns, quiet = std::max(1 - sudden, 1e-3);
    if (from.turning) {
        turn_slowly(from, quiet * goes_on, course::goes_on, from.speed, from.near);
        turn_slowly(from, quiet * (1 - goes_on), course::ends, from.speed, from.near);
    } else {
        remain_untouched(from, quiet * (1 - turns) * (1 - hands));
        begin_turning(from, quiet * turns, quiet * hands);
    }
    turn_suddenly(from, at_border * turns);
    touch_unexplained(from, at_border * may.unexplained);
    for (const auto& [tag, share] : courses(from))
        press(tag, at_border * may.press * share);
    mix(from, (1 - at_border) * sudden);
}

void press_filter::branch_touched(const explanation& from)
{
    const changes may(from.age_s, d_elapsed_s, 1, d_set);
    const double turns = turn_probability(from), goes_on = going_on();
    const double sudden = may.all - may.steadily + turns;
    // What happened suddenly in the group before may take a part of this one.
    const double lasts = from.jolted || from.jumped ? lasting() : 0;
    const double quiet = std::max(1 - sudden - lasts, 1e-3);
    if (from.jolted)
        turn_suddenly(from, lasts);
    if (from.jumped)
        jump(from, lasts);
    const double begins = std::min(may.steadily / quiet, surest_change);
    if (from.turning && from.steady) {
        // Both go on, or one of them ends.
        const double ends = quiet * (1 - goes_on) / 2;
        change_steadily(from, quiet * goes_on, from.slides, from.speed);
        auto resting = from, held = from;
        resting.turning = false;
        resting.motion.push(-from.velocity);
        change_steadily(resting, ends, from.slides, from.speed);
        held.steady = false;
        held.motion.move(from.velocity, squared(from.velocity) / 4);
        turn_slowly(held, ends, course::goes_on, from.speed, from.near);
    } else if (from.turning) {
        turn_slowly(
            from, quiet * goes_on * (1 - begins), course::goes_on, from.speed, from.near);
        turn_slowly(from, quiet * (1 - goes_on), course::ends, from.speed, from.near);
        for (std::size_t i = 0; i < speeds.size(); i++)
            change_steadily(from, quiet * goes_on * begins / speeds.size(), false, i);
    } else if (from.steady) {
        auto turning = from;
        turning.turning = true;
        turning.velocity = 0;
        // A force that rises ever more slowly is one change, and it may begin to slide.
        const double slows = from.speed > 0 ? 1 - goes_on : 0,
                     slips = from.slides ? 0 : sliding * (1 - goes_on),
                     stays = quiet * goes_on * (1 - turns);
        change_steadily(from, stays * (1 - slows - slips), from.slides, from.speed);
        if (slows > 0)
            change_steadily(from, stays * slows, from.slides, from.speed - 1);
        if (slips > 0)
            change_steadily(from, stays * slips, true, from.speed);
        change_steadily(turning, quiet * goes_on * turns, from.slides, from.speed);
        hold(from, quiet * (1 - goes_on));
    } else {
        hold(from, quiet * (1 - begins) * (1 - turns));
        for (std::size_t i = 0; i < speeds.size(); i++) {
            const double each = quiet * begins / speeds.size();
            change_steadily(from, (1 - sliding) * each, false, i);
            change_steadily(from, sliding * each, true, i);
        }
        begin_turning(from, quiet * turns, 0);
    }
    turn_suddenly(from, at_border * turns);
    touch_unexplained(from, at_border * may.unexplained);
    for (const auto& [tag, share] : courses(from)) {
        release(tag, at_border * may.release * share);
        press(tag, at_border * may.exchange * share);
        jump(tag, at_border * may.jump * share);
    }
    mix(from, (1 - at_border) * sudden, may.release / sudden);
}

void press_filter::branch_mixed(const explanation& from)
{
    const changes may(from.age_before_s, d_elapsed_s, 1, d_set);
    const double turns = turn_probability(from);
    const double lasts = lasting();
    const bool touched = from.before != untouched;
    const double all = (may.all - (touched ? may.steadily : 0) + turns) / (1 - lasts);
    // What was seen of a single group of change lies between the states before and after
    // it.
    const bool single = from.groups == 1;
    const double known = single ? from.log_density : 0;
    const double to_this =
        single ? chord(from, seen_ratio(), d_difference_noise / 2) - known : 0;
    auto as_before = from;
    as_before.is = from.before;
    as_before.age_s = from.age_before_s;
    as_before.log_weight += to_this;
    turn_suddenly(as_before, turns / all);
    touch_unexplained(as_before, may.unexplained / all);
    for (auto& [tag, share] : courses(from)) {
        const double to_untouched = single && tag.known && !tag.turned_now
                                        ? chord(tag, untouched_ratio(tag), 0) - known
                                        : to_this;
        auto ended = tag;
        ended.log_weight += to_untouched;
        tag.log_weight += to_this;
        tag.is = from.before;
        if (touched) {
            release(ended, may.release * share / all);
            press(tag, may.exchange * share / all);
            jump(tag, may.jump * share / all);
        } else {
            release(ended, 0.1 * may.press * share / all); // a tap
            press(tag, 0.9 * may.press * share / all);
        }
    }
    mix(from, lasts);
}

void press_filter::begin_turning(const explanation& from, double turns, double hands)
{
    for (std::size_t i = 0; i < turning_speeds; i++) {
        turn_slowly(from, turns / turning_speeds, course::begins, i, false);
        if (i < near_speeds)
            turn_slowly(from, hands / near_speeds, course::begins, i, true);
    }
}

double press_filter::turn_probability(const explanation& of) const
{
    return -std::expm1(-turn_rate(of) / 2 * d_elapsed_s);
}

// Of a sudden change, that it is not over.
double press_filter::lasting() const
{
    return std::clamp(std::exp(-d_elapsed_s / d_set.change_s), 0.1, 0.9);
}

double press_filter::going_on() const { return std::exp(-d_elapsed_s / d_set.steady_s); }

// What the tag may do while the press changes: nothing, or turn suddenly; or go on
// turning, or come to rest.
std::vector<std::pair<press_filter::explanation, double>>
press_filter::courses(const explanation& from) const
{
    auto other = from;
    if (from.turning && from.near) {
        lose_sight_of_hand(other);
        return { { other, 1 } };
    }
    if (from.turning) {
        auto resting = from;
        const double by = from.velocity * d_elapsed_s;
        other.common.turn(by);
        other.common.widen(squared(by) / 12);
        other.motion.turn(by);
        resting.common.turn(by / 2);
        resting.common.widen(squared(by) / 3);
        resting.motion.turn(by / 2);
        resting.turning = false;
        return { { other, going_on() }, { resting, 1 - going_on() } };
    }
    const double turns = turn_probability(from), variance = squared(d_set.turn_deg * deg);
    other.turned_now = true;
    other.turns += from.is == untouched;
    other.common.widen(variance);
    other.motion.widen({ variance, variance, variance });
    other.line.mean_variance += squared(d_set.turn_np);
    other.strength.mean_variance += squared(d_set.turn_np);
    return { { from, 1 - turns }, { other, turns } };
}

// ---- what follows, and how well it predicts the group

void press_filter::remain_untouched(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.turning = false;
    next.lasts = true;
    give(next, update_baseline(next));
}

void press_filter::turn_suddenly(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.turns += from.is == untouched;
    next.turning = next.steady = next.near = false;
    next.jolted = next.turned_now = true;
    begin_turn(next);
    const auto was = next.motion.phase();
    const double variance = squared(d_set.turn_deg * deg);
    next.motion.widen({ variance, variance, variance });
    next.strength.mean_variance += squared(d_set.turn_np);
    give(next, follow_turn(next, was));
}

void press_filter::turn_slowly(
    const explanation& from, double probability, course how, std::size_t speed, bool near)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.speed = speed;
    next.steady = false;
    next.turning = how != course::ends;
    next.near = near;
    if (how == course::begins) {
        next.turns += !near && from.is == untouched;
        begin_turn(next);
    }
    if (near) // adds a phasor of any angle, so it changes amplitude and phase alike
        next.strength.mean_variance +=
            squared(speeds[speed]) * d_elapsed_s * std::max(d_elapsed_s, least_turn_s);
    const auto was = next.motion.phase();
    if (how != course::ends)
        next.motion.widen_velocity(alike_both,
                                   squared(speeds[speed]) *
                                       (how == course::begins ? 1 : d_elapsed_s),
                                   0);
    next.motion.predict(d_elapsed_s);
    if (how == course::ends)
        next.motion.stop(d_elapsed_s);
    give(next, follow_turn(next, was));
}

void press_filter::begin_turn(explanation& to) const
{
    if (to.is != untouched) {
        to.common.widen(
            d_common_noise); // how far it turns is seen with the noise of a group
        return;
    }
    to.motion.hold(baseline(to), covariance_of(to.common, to.difference));
    to.strength = to.line;
}

// Both ends turn alike, whether they are touched or not, and the untouched line with
// them.
double press_filter::follow_turn(explanation& to, const pair_of_ends& was) const
{
    drift(to);
    double likelihood = to.motion.evidence(d_group.phase, d_noise);
    to.motion.update(d_group.phase, d_noise);
    hold_level(to);
    const double before = to.strength.mean;
    likelihood += update_amplitude(to.strength);
    const auto is = to.motion.phase();
    const double by = (is[0] - was[0] + is[1] - was[1]) / 2;
    to.common.turn(by);
    // What is seen in the second group of a press may have begun in the first.
    if (to.is != untouched && to.age_s < 1.5 * d_elapsed_s)
        to.common.widen(squared(by / 2));
    to.line.mean += to.strength.mean - before;
    if (!to.near)
        to.quiet_amplitude += to.strength.mean - before;
    to.velocity = to.motion.common_velocity();
    if (to.is == untouched) {
        const auto sure = to.motion.covariance();
        to.common.reset(to.common.estimate().mean,
                        (sure.first + sure.second + 2 * sure.both) / 4);
        to.line = to.strength;
        notice_hand(to);
    }
    return likelihood;
}

void press_filter::release(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.is = untouched;
    next.age_s = 0;
    double likelihood;
    if (from.known)
        likelihood = update_baseline(next);
    else {
        // Now it is seen from where the press before looked as it did.
        const auto was = from.motion.phase();
        likelihood = std::log(d_image->density({ was[0] - d_group.phase[0],
                                                 was[1] - d_group.phase[1] }) +
                              1e-12) +
                     compare_contact(from, any_amplitude);
        reset_baseline(next);
        next.known = true;
    }
    if (next.turning) {
        begin_turn(next);
        next.motion.move(next.velocity, squared(next.velocity) / 4);
    }
    give(next, likelihood);
}

void press_filter::press(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.is = pressed;
    next.age_s = 0;
    begin_press(next);
    if (next.turning) {
        next.motion.move(next.velocity, squared(next.velocity) / 4);
    }
    const double phases =
        from.known ? std::log(density(from, d_group.phase) + 1e-12) : log_any_phases;
    give(next, phases + compare_contact(from, d_set.contact_np));
}

void press_filter::touch_unexplained(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.is = unexplained;
    next.age_s = 0;
    next.turning = false;
    begin_press(next);
    double explained = 0, near = 0;
    if (from.known) {
        explained = density(from, d_group.phase);
        const auto at = baseline(from);
        for (int e = 0; e < 2; e++)
            near +=
                squared(wrapped(d_group.phase[e] - at[e]) / (least_contact_deg * deg));
        near = 0.99 * std::exp(-squared(near) / 2);
    }
    give(next,
         log_any_phases - std::log1p(explained / outside) + std::log1p(-near) +
             compare_contact(from, any_amplitude));
}

void press_filter::hold(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.steady = false;
    next.lasts = !from.steady;
    if (from.steady) {
        next.age_s = 0;
        drift(next);
        next.motion.predict(d_elapsed_s);
        next.motion.stop(d_elapsed_s);
        const double likelihood = next.motion.evidence(d_group.phase, d_noise);
        next.motion.update(d_group.phase, d_noise);
        hold_level(next);
        give(next, likelihood + update_amplitude(next.strength));
        return;
    }
    // What is held drifts as the untouched line does, and looks like it.
    const double likelihood = update_phases(next.held_common, next.held_difference);
    next.common.share_rates(next.held_common);
    next.difference.share_rates(next.held_difference);
    next.motion.hold(phases_of(next.held_common, next.held_difference),
                     covariance_of(next.held_common, next.held_difference));
    give(next, likelihood + update_amplitude(next.strength));
}

void press_filter::change_steadily(const explanation& from,
                                   double probability,
                                   bool slides,
                                   std::size_t speed)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.steady = true;
    next.slides = slides;
    next.speed = speed;
    next.age_s = 0;
    drift(next);
    // What slides, or rolls, moves both phases in any direction.
    const auto direction = press_direction(from);
    const double aside = slides ? 1.0 : direction_variance(from);
    if (from.steady && !slides)
        next.motion.bend(from.direction, direction);
    next.direction = direction;
    // The speed begins, or changes as much within a second; the direction keeps its
    // error.
    const double along = squared(speeds[speed]) * (from.steady ? d_elapsed_s : 1.0);
    if (from.steady && !slides)
        next.motion.widen_velocity(next.motion.heading(direction),
                                   along,
                                   aside * squared(next.motion.speed()) * d_elapsed_s);
    else
        next.motion.widen_velocity(direction, along, aside * along);
    if (from.turning) // by what it turned before, or by anything
        next.motion.widen_velocity(alike_both,
                                   2 * squared(speeds[1]) *
                                       (from.velocity == 0 ? 1 : d_elapsed_s),
                                   0);
    next.motion.predict(d_elapsed_s);
    const auto was = from.motion.phase();
    double likelihood = next.motion.evidence(d_group.phase, d_noise);
    next.motion.update(d_group.phase, d_noise);
    if (from.turning)
        part_turn(next, was, direction);
    // The mean of phasors that turn by x has lost x^2 / 24 of its magnitude, and one that
    // turns in a part of the group only up to x^2 / 8.
    double turned = 0;
    for (int e = 0; e < 2; e++)
        turned += squared(wrapped(d_group.phase[e] - was[e]));
    next.strength.mean_variance += squared(turned / 24);
    next.strength.difference_variance += squared(turned / 24);
    likelihood += update_amplitude(next.strength);
    if (next.is == pressed && next.known) {
        const double inside = density(next, next.motion.phase()),
                     before = density(from, was);
        likelihood += std::log((inside + 1e-12) / (inside + outside)) -
                      std::log((before + 1e-12) / (before + outside));
    }
    give(next, likelihood);
}

// While the tag turns and the force changes: both phases are moved by the turn alike, and
// by the force in the direction of the press. In the middle of the line that is the same.
void press_filter::part_turn(explanation& to,
                             const pair_of_ends& was,
                             const pair_of_ends& direction) const
{
    const auto is = to.motion.phase();
    const double expected = to.velocity * d_elapsed_s;
    const double first = is[0] - was[0] - expected, second = is[1] - was[1] - expected;
    const double by_turn = squared(speeds[1] * d_elapsed_s),
                 by_force = squared(speeds[to.speed] * d_elapsed_s),
                 noise = d_noise.first / 100;
    const double a = by_force * direction[0] * direction[0] + by_turn + noise,
                 b = by_force * direction[1] * direction[1] + by_turn + noise,
                 ab = by_force * direction[0] * direction[1] + by_turn;
    const double determinant = a * b - ab * ab;
    const double turned = by_turn * ((b - ab) * first + (a - ab) * second) / determinant,
                 doubt = by_turn - squared(by_turn) * (a + b - 2 * ab) / determinant;
    to.common.turn(expected + turned);
    to.common.widen(std::max(doubt, 0.0));
    to.velocity += 0.3 * turned / d_elapsed_s;
}

void press_filter::jump(const explanation& from, double probability)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.age_s = 0;
    next.steady = false;
    next.jumped = true;
    drift(next);
    const auto direction = press_direction(from);
    const double x = direction[0], y = direction[1], along = squared(jump_deg * deg),
                 across = direction_variance(from) * along;
    next.motion.widen({ along * x * x + across * y * y,
                        along * y * y + across * x * x,
                        (along - across) * x * y });
    const auto was = from.motion.phase();
    double likelihood = next.motion.evidence(d_group.phase, d_noise);
    next.motion.update(d_group.phase, d_noise);
    hold_level(next);
    likelihood += update_amplitude(next.strength);
    // What hardly differs is no jump.
    double jumped = 0;
    for (int e = 0; e < 2; e++)
        jumped += squared(wrapped(d_group.phase[e] - was[e]));
    likelihood += std::log((jumped + 1e-12) / (jumped + squared(least_jump_deg * deg)));
    if (next.is == pressed && next.known) {
        const double inside = density(next, next.motion.phase()),
                     before = density(from, was);
        likelihood += std::log((inside + 1e-12) / (inside + outside)) -
                      std::log((before + 1e-12) / (before + outside));
    }
    give(next, likelihood);
}

void press_filter::mix(const explanation& from, double probability, double ends)
{
    auto followed = follow(from, probability);
    if (!followed)
        return;
    auto& next = *followed;
    next.is = mixed;
    next.steady = false;
    if (next.turning && next.near)
        lose_sight_of_hand(next);
    if (next.turning) {
        const double by = next.velocity * d_elapsed_s;
        next.common.turn(by);
        next.common.widen(squared(by) / 12);
        next.motion.turn(by);
    }
    next.seen = seen_ratio();
    next.seen_variance = d_difference_noise / 2;
    next.log_density = 0;
    if (from.is == mixed)
        next.groups++;
    else {
        next.groups = 1;
        next.before = from.is;
        next.age_before_s = from.age_s;
        if (from.is == untouched)
            next.start = untouched_ratio(from);
        else {
            const auto was = from.motion.phase();
            for (int e = 0; e < 2; e++)
                next.start[e] =
                    std::polar(std::exp(from.strength.mean +
                                        (e ? -0.5 : 0.5) * from.strength.difference),
                               was[e]);
        }
        // Where a press ends, it is known what comes after.
        if (ends > 0 && from.known)
            next.log_density =
                log_sum(std::log(ends) + chord(next, untouched_ratio(from), 0),
                        std::log1p(-ends));
    }
    give(next, log_any_mixture + next.log_density);
}

// ---- parts of them

// What follows with this probability, before the event has changed it; nothing where even
// the best prediction of the group would leave no weight.
std::optional<press_filter::explanation> press_filter::follow(const explanation& from,
                                                              double probability) const
{
    const double log_weight = from.log_weight + std::log(probability);
    if (!(log_weight + d_peak > d_best + negligible - 12))
        return std::nullopt;
    auto next = from;
    next.log_weight = log_weight;
    next.jolted = next.jumped = next.lasts = false;
    return next;
}

void press_filter::give(explanation& next, double log_likelihood)
{
    next.log_weight += log_likelihood;
    if (!(next.log_weight > d_best + negligible))
        return;
    d_best = std::max(d_best, next.log_weight);
    average(next);
    next.last = next.now;
    next.now = describe(next);
    d_next.push_back(next);
}

// Mean of the groups for as long as nothing changes: of as many as last smoothing_s.
void press_filter::average(explanation& to) const
{
    auto& mean = to.mean;
    const double x = d_set.smoothing_s > 0 ? d_elapsed_s / d_set.smoothing_s : 1;
    const double kept = to.lasts ? std::max(0.0, (1 - x) / (1 + x)) : 0;
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

double press_filter::step_probability()
{
    if (d_group.retuned)
        return d_stepped = 1;
    const double variance = d_group.receiver_variance;
    // A step may take a part of the group before and a part of this one.
    const double prior =
        std::max(-std::expm1(-d_set.steps * d_elapsed_s), d_stepped * lasting());
    // Of any size, in equal parts per octave of four decades.
    const double size2 =
        squared(d_group.receiver_phase) + squared(d_group.receiver_amplitude) + variance;
    const double log_step =
                     std::log(prior + 1e-300) - std::log(two_pi * size2 * std::log(1e4)),
                 log_none = log_normal(d_group.receiver_phase, variance) +
                            log_normal(d_group.receiver_amplitude, variance);
    const double steps = 1 / (1 + std::exp(std::min(log_none - log_step, 700.0)));
    return d_stepped = steps < 1e-7 ? 0 : steps > 1 - 1e-7 ? 1 : steps;
}

void press_filter::step_receiver(explanation& to) const
{
    const bool unknown = d_group.retuned;
    const double by = unknown ? 0 : d_group.receiver_phase,
                 gain = unknown ? 0 : d_group.receiver_amplitude,
                 variance = unknown ? unknown_phase : 2 * d_group.receiver_variance;
    to.common.turn(by);
    to.common.widen(variance);
    to.line.mean += gain;
    to.quiet_amplitude += gain;
    to.quiet_phase += by;
    to.line.mean_variance += variance;
    to.motion.turn(by);
    to.motion.widen({ variance, variance, variance });
    to.held_common.turn(by);
    to.held_common.widen(variance);
    to.strength.mean += gain;
    to.strength.mean_variance += variance;
    for (int e = 0; e < 2; e++) {
        to.mean.phase[e] += by;
        to.mean.amplitude[e] += gain;
        to.mean.weight[e] = unknown ? 0 : to.mean.weight[e];
        to.start[e] *= std::polar(std::exp(gain), by);
        to.seen[e] *= std::polar(std::exp(gain), by);
    }
}

void press_filter::reset_baseline(explanation& to) const
{
    const double apart = wrapped(d_group.phase[0] - d_group.phase[1]);
    to.common.reset(d_group.phase[1] + apart / 2, d_common_noise);
    to.difference.reset(apart, d_difference_noise);
    to.line = seen_amplitude();
    to.quiet_amplitude = d_amplitude;
    to.quiet_phase = to.common.estimate().mean;
    to.near_square = 0;
}

void press_filter::drift(explanation& to) const
{
    const double common = squared(to.common.usual_rate()) * d_elapsed_s,
                 apart = squared(to.difference.usual_rate()) * d_elapsed_s / 4;
    to.motion.widen({ common + apart, common + apart, common - apart });
}

// Takes the phases of the group as those of a line that drifts.
double press_filter::update_phases(drift_bank& common, drift_bank& difference) const
{
    const double memory = std::max(0.0, 1 - d_elapsed_s / d_set.drift_memory_s);
    const auto known = difference.estimate();
    const double apart =
        known.mean + wrapped(d_group.phase[0] - d_group.phase[1] - known.mean);
    return common.update(d_group.phase[1] + apart / 2, d_common_noise, memory) +
           difference.update(apart, d_difference_noise, memory);
}

// A press is held from where it is now.
void press_filter::hold_level(explanation& to) const
{
    const auto is = to.motion.phase();
    const auto sure = to.motion.covariance();
    const double apart = wrapped(is[0] - is[1]);
    to.held_common.reset(is[1] + apart / 2,
                         (sure.first + sure.second + 2 * sure.both) / 4);
    to.held_difference.reset(apart, sure.first + sure.second - 2 * sure.both);
}

double press_filter::update_baseline(explanation& to) const
{
    double likelihood = update_phases(to.common, to.difference);
    likelihood += update_amplitude(to.line);
    notice_hand(to);
    return likelihood;
}

// It goes on to where it presses.
void press_filter::lose_sight_of_hand(explanation& to) const
{
    to.turning = false;
    to.near_square += squared(to.velocity * d_set.near_s);
}

// A hand that comes near adds a phasor. While it moves the untouched line shows how large
// that is; during a press, the phase that it adds is known to no better than this.
void press_filter::notice_hand(explanation& to) const
{
    const bool moves = to.turning && to.near;
    const double phase = to.common.estimate().mean,
                 turned = moves ? wrapped(phase - to.quiet_phase) : 0,
                 grown = to.line.mean - to.quiet_amplitude;
    const double forgets = std::min(1.0, d_elapsed_s / d_set.near_s);
    to.near_square = std::max((1 - forgets) * to.near_square,
                              squared(turned) + squared(grown) - to.line.mean_variance);
    to.quiet_phase = phase - turned * (1 - forgets / 4);
    to.quiet_amplitude += forgets / 4 * grown;
}

double press_filter::compare_contact(const explanation& with, double spread) const
{
    const double known =
        with.line.mean_variance + with.near_square / 2 + d_amplitude_noise;
    const auto density = [&](double loss) {
        return log_normal(d_amplitude - with.line.mean, known + squared(loss) / 2) +
               log_normal(d_amplitude_difference - with.line.difference,
                          with.line.difference_variance + 4 * d_amplitude_noise +
                              2 * squared(loss));
    };
    // Good contacts lose nothing.
    return log_sum(density(spread), density(0)) - std::log(2.0);
}

double press_filter::update_amplitude(both_amplitudes& own) const
{
    const double mean = d_amplitude - own.mean,
                 difference = d_amplitude_difference - own.difference;
    const double mean_variance = own.mean_variance + d_amplitude_noise,
                 difference_variance = own.difference_variance + 4 * d_amplitude_noise;
    const double likelihood =
        log_normal(mean, mean_variance) + log_normal(difference, difference_variance);
    const double by_mean = own.mean_variance / mean_variance,
                 by_difference = own.difference_variance / difference_variance;
    own.mean += by_mean * mean;
    own.difference += by_difference * difference;
    own.mean_variance *= 1 - by_mean;
    own.difference_variance *= 1 - by_difference;
    return likelihood;
}

void press_filter::begin_press(explanation& to) const
{
    to.steady = false;
    to.motion.hold(d_group.phase, d_noise);
    to.held_common = to.common;
    to.held_difference = to.difference;
    hold_level(to);
    to.strength = seen_amplitude();
}

press_filter::both_amplitudes press_filter::seen_amplitude() const
{
    return {
        d_amplitude, d_amplitude_difference, d_amplitude_noise, 4 * d_amplitude_noise
    };
}

double press_filter::density(const explanation& of, const pair_of_ends& phase) const
{
    const auto at = baseline(of);
    const double variance = of.common.estimate().variance + of.near_square / 2;
    const pair_of_ends change{ phase[0] - at[0], phase[1] - at[1] };
    const double middle = d_image->density(change);
    if (variance < squared(deg))
        return middle;
    // Gauss-Hermite quadrature over the common phase.
    const double away = std::sqrt(3 * std::min(variance, 1.0));
    return 2.0 / 3 * middle + (d_image->density({ change[0] - away, change[1] - away }) +
                               d_image->density({ change[0] + away, change[1] + away })) /
                                  6;
}

// Log density of a mixture of the state before and the one after, over that of any
// mixture.
double
press_filter::chord(const explanation& from, const both_ends& to, double variance) const
{
    double length2 = 0, along = 0, noise = 0;
    both_ends step, seen;
    for (int e = 0; e < 2; e++) {
        step[e] = to[e] - from.start[e];
        seen[e] = from.seen[e] - from.start[e];
        length2 += std::norm(step[e]);
        along += (std::conj(step[e]) * seen[e]).real();
        noise += (from.seen_variance + variance / 4) / 2 * std::norm(from.start[e]);
    }
    const double share = std::clamp(along / std::max(length2, 1e-12), 0.0, 1.0);
    double off = 0;
    for (int e = 0; e < 2; e++)
        off += std::norm(seen[e] - share * step[e]);
    // Three degrees of freedom lie across the chord. A change that takes a part of the
    // group follows the circle, so that its mean lies beside the chord; and the force may
    // have changed before the press ended, or after it began.
    const double beside = noise + squared(length2 * share * (1 - share) / 4),
                 ramped = beside + squared(ramp_deg * deg);
    const auto across = [&](double v) {
        return std::exp(-0.5 * off / v) / std::pow(two_pi * v, 1.5);
    };
    const double on = (across(noise) + across(beside) + across(ramped)) / 4 /
                      (std::sqrt(length2) + 3 * std::sqrt(noise));
    return std::log(on * std::exp(-log_any_mixture) + 0.25);
}

press_filter::both_ends press_filter::untouched_ratio(const explanation& of) const
{
    const auto at = baseline(of);
    const double half = of.line.difference / 2;
    return { std::polar(std::exp(of.line.mean + half), at[0]),
             std::polar(std::exp(of.line.mean - half), at[1]) };
}

press_filter::both_ends press_filter::seen_ratio() const
{
    return { std::polar(std::exp(d_group.amplitude[0]), d_group.phase[0]),
             std::polar(std::exp(d_group.amplitude[1]), d_group.phase[1]) };
}

pair_of_ends press_filter::baseline(const explanation& of) const
{
    return phases_of(of.common, of.difference);
}

// Of the direction, rad^2; any where the model does not say.
double press_filter::direction_variance(const explanation& of) const
{
    return of.known && of.is == pressed ? squared(d_set.aside) : 1.0;
}

pair_of_ends press_filter::press_direction(const explanation& of) const
{
    if (!of.known || of.is != pressed)
        return alike_both;
    const auto at = baseline(of), is = of.motion.phase();
    return d_image->direction({ is[0] - at[0], is[1] - at[1] });
}

press_filter::outcome press_filter::describe(const explanation& of) const
{
    const auto common = of.common.estimate(), apart = of.difference.estimate();
    return {
        of.is,          of.before,
        of.known,       of.turned_now || of.turning,
        baseline(of),   common.variance + (of.is == pressed ? of.near_square / 2 : 0),
        apart.variance, of.line.mean,
        of.mean
    };
}

// ---- keeping the likely ones

void press_filter::settle()
{
    std::sort(d_next.begin(), d_next.end(), [](const auto& a, const auto& b) {
        return a.log_weight > b.log_weight;
    });
    d_kept.clear();
    for (const auto& next : d_next) {
        if (next.log_weight < d_best + negligible)
            break;
        const auto same =
            std::find_if(d_kept.begin(), d_kept.end(), [&](const auto& kept) {
                return alike(kept, next);
            });
        if (same != d_kept.end())
            same->log_weight = log_sum(same->log_weight, next.log_weight);
        else if (d_kept.size() < most_kept)
            d_kept.push_back(next);
    }
    double total = 0;
    for (const auto& kept : d_kept)
        total += std::exp(kept.log_weight - d_best);
    for (auto& kept : d_kept)
        kept.log_weight -= d_best + std::log(total);
}

double press_filter::turn_rate(const explanation& of) const
{
    return (d_set.turns * d_set.turns_s + of.turns) / (d_set.turns_s + of.untouched_s);
}

bool press_filter::alike(const explanation& a, const explanation& b) const
{
    if (a.is != b.is || a.known != b.known || a.turning != b.turning ||
        ((a.turning || a.steady) && (a.near != b.near || a.speed != b.speed)) ||
        a.last.is != b.last.is || a.last.known != b.last.known)
        return false;
    if (a.is == mixed && (a.before != b.before || a.groups != b.groups))
        return false;
    const auto near = [](double x, double y, double variance) {
        return squared(wrapped(x - y)) < 0.1 * variance;
    };
    if (a.is == pressed || a.is == unexplained) {
        if (a.steady != b.steady)
            return false;
        if (!a.motion.near(b.motion))
            return false;
    }
    const auto common = a.common.estimate(), other = b.common.estimate();
    const auto apart = a.difference.estimate(), other_apart = b.difference.estimate();
    if (!near(common.mean, other.mean, common.variance + d_common_noise) ||
        !near(apart.mean, other_apart.mean, apart.variance + d_difference_noise) ||
        common.variance > 4 * other.variance + d_common_noise ||
        other.variance > 4 * common.variance + d_common_noise)
        return false;
    return a.last.is != pressed || (near(a.last.baseline[0],
                                         b.last.baseline[0],
                                         a.last.common_variance + d_common_noise) &&
                                    near(a.last.baseline[1],
                                         b.last.baseline[1],
                                         a.last.common_variance + d_common_noise));
}

std::vector<press_filter::weighted_outcome>
press_filter::collect(outcome explanation::*which) const
{
    std::vector<weighted_outcome> found;
    for (const auto& kept : d_kept) {
        const auto& what = kept.*which;
        const double weight = std::exp(kept.log_weight);
        const auto same =
            std::find_if(found.begin(), found.end(), [&](const auto& other) {
                return other.what.is == what.is && other.what.before == what.before &&
                       other.what.known == what.known && other.what.turns == what.turns &&
                       other.what.baseline == what.baseline;
            });
        if (same != found.end())
            same->weight += weight;
        else
            found.push_back({ weight, what });
    }
    std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
        return a.weight > b.weight;
    });
    return found;
}

std::vector<press_filter::weighted_outcome> press_filter::newest() const
{
    return collect(&explanation::now);
}

std::vector<press_filter::weighted_outcome> press_filter::before_newest() const
{
    return collect(&explanation::last);
}

void press_filter::claim_untouched(double probability)
{
    if (d_kept.empty())
        return;
    double already = 0;
    for (const auto& kept : d_kept)
        already += kept.is == untouched ? std::exp(kept.log_weight) : 0;
    if (already < 0.5) {
        // It looked touched: the phases of the untouched line would be those of the
        // newest group.
        explanation next = d_kept.front();
        const auto level = next.motion.phase();
        const auto sure = next.motion.covariance();
        const bool held = (next.is == pressed || next.is == unexplained) && !next.steady;
        next.is = untouched;
        next.known = true;
        next.turning = false;
        next.age_s = 0;
        reset_baseline(next);
        if (held) {
            const double apart = wrapped(level[0] - level[1]);
            next.common.reset(level[1] + apart / 2,
                              (sure.first + sure.second + 2 * sure.both) / 4);
            next.difference.reset(apart, sure.first + sure.second - 2 * sure.both);
            next.line = next.strength;
            next.quiet_amplitude = next.line.mean;
        }
        next.now = describe(next);
        // If it is true, nothing changes any more; so it is compared with a press that
        // rests.
        for (auto& kept : d_kept) {
            kept.log_weight += std::log1p(-probability);
            if (kept.steady) {
                kept.steady = false;
                kept.age_s = 0;
                hold_level(kept);
            }
        }
        next.log_weight = std::log(probability);
        d_kept.insert(d_kept.begin(), next);
        return;
    }
    // What the user says is worth so much, however often it is said.
    const double sure = std::max(already, probability);
    for (auto& kept : d_kept)
        kept.log_weight += kept.is == untouched
                               ? std::log(sure / already)
                               : std::log((1 - sure) / std::max(1 - already, 1e-12));
}

void press_filter::change_reference(const pair_of_ends& phase, const pair_of_ends& by)
{
    const double apart = wrapped(phase[0] - phase[1]), mean = phase[1] + apart / 2;
    const double amplitude = (by[0] + by[1]) / 2;
    for (int e = 0; e < 2; e++) {
        d_group.phase[e] += phase[e];
        d_group.amplitude[e] += by[e];
    }
    d_amplitude += amplitude;
    d_amplitude_difference += by[0] - by[1];
    for (auto& kept : d_kept) {
        kept.common.turn(mean);
        kept.difference.turn(apart);
        kept.held_common.turn(mean);
        kept.held_difference.turn(apart);
        kept.line.mean += amplitude;
        kept.line.difference += by[0] - by[1];
        kept.quiet_amplitude += amplitude;
        kept.quiet_phase += mean;
        auto was = kept.motion.phase();
        kept.motion.hold({ was[0] + phase[0], was[1] + phase[1] },
                         kept.motion.covariance());
        kept.strength.mean += amplitude;
        kept.strength.difference += by[0] - by[1];
        for (int e = 0; e < 2; e++) {
            kept.start[e] *= std::polar(std::exp(by[e]), phase[e]);
            kept.seen[e] *= std::polar(std::exp(by[e]), phase[e]);
            for (auto* mean : { &kept.mean, &kept.now.mean, &kept.last.mean }) {
                mean->phase[e] += phase[e];
                mean->amplitude[e] += by[e];
            }
            kept.now.baseline[e] += phase[e];
            kept.last.baseline[e] += phase[e];
        }
        kept.now.amplitude += amplitude;
        kept.last.amplitude += amplitude;
    }
}

} // namespace gr::wiforce::kernel
