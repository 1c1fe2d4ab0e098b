// SPDX-License-Identifier: GPL-3.0-or-later
// What may follow in a group, and how well each predicts it.
#include "press_filter.h"
#include "press_terms.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

void press_filter::remain_untouched(const explanation& from, double probability)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    next->claimed = from.claimed;
    give(*next, update_baseline(*next), true);
}

void press_filter::turn_suddenly(const explanation& from, double probability)
{
    const double variance = sudden_turn_variance();
    const phase_covariance turned{ variance, variance, variance };
    auto* const next = follow(from, probability, phase_peak(turned));
    if (!next)
        return;
    next->turn.seen += learns_turns(from);
    if (from.is != untouched)
        next->age_s = 0;
    next->turn.goes_on = next->press.steady = next->turn.by_hand = false;
    next->turn.sudden = true;
    next->press.motion.rest();
    start_motion(*next, true);
    const auto was = next->press.motion;
    next->press.motion.widen(turned);
    give(*next, follow_turn(*next, was));
}

void press_filter::turn_slowly(
    const explanation& from, double probability, course how, std::size_t speed, bool near)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    next->press.steady = false;
    if (from.is != untouched && speed != warm_speed)
        next->age_s = 0; // as after a change of force, which looks the same at mid-line
    const bool begins = how == course::begins;
    if (begins) {
        next->turn.begin(speed, near);
        count_turn(*next, from);
    }
    start_motion(*next, begins);
    next->turn.goes_on = how != course::ends;
    next->turn.speed = speed;
    const auto was = next->press.motion;
    if (how != course::ends) {
        const double by = squared(turning_speed(speed)) * (begins ? 1 : d_elapsed_s) / 2;
        next->press.motion.widen_velocity({ by, by, by });
    }
    next->press.motion.predict(d_elapsed_s);
    if (how == course::ends)
        next->press.motion.stop(d_elapsed_s);
    give(*next, follow_turn(*next, was), speed == warm_speed);
}

void press_filter::count_turn(explanation& to, const explanation& from) const
{
    (to.turn.by_hand ? to.turn.hands : to.turn.seen) += learns_turns(from);
}

// Where the phases are before they turn: an untouched line, as it is predicted, where its
// turn begins; else they have drifted since the group before.
void press_filter::start_motion(explanation& to, bool begins) const
{
    if (!begins || to.is != untouched) {
        drift(to);
        return;
    }
    to.press.motion.hold(to.line.phase(), to.line.covariance());
    to.press.strength = to.line.amplitude;
}

// Both ends turn alike, whether they are touched or not, and the untouched line with
// them: by how much is known as well as where they were and are.
double press_filter::follow_turn(explanation& to, const phase_motion& was) const
{
    const double phases = to.press.motion.update(d_group.phase, d_noise);
    const double tied = to.is == untouched ? 0 : to.press.held.common.with();
    to.hold_level();
    const double by = to.press.motion.means()[0] - was.means()[0],
                 error = to.press.motion.variances()[0];
    to.line.common.turn(by);
    to.mean.recount({ by, by }, {});
    to.line.common.widen(was.variances()[0] - 2 * tied + error);
    to.press.held.common.tie(error);
    const double grows = to.turn.by_hand
                             ? hand_variance(to.turn.speed)
                             : squared(d_set.turn_np / (d_set.turn_deg * deg) * by);
    const double likelihood = update_strength_while_turning(to, phases, { grows, 0 });
    to.turn.velocity = to.press.motion.means()[2];
    if (to.is == untouched) {
        to.line.reset(to.press.motion.phase(), to.press.motion.covariance());
        to.line.amplitude = to.press.strength;
    }
    return likelihood;
}

// What a finger has warmed, or pressed for long, may come back slowly from now on.
void press_filter::release(const explanation& from, double probability)
{
    const double cool = probability * warming_probability(from);
    leave(from, probability - cool, false);
    leave(from, cool, true);
}

void press_filter::leave(const explanation& from, double probability, bool cools)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    // What was warmed cools, whether it went on warming or not.
    if (cools || (from.turn.goes_on && from.turn.speed == warm_speed))
        next->turn.begin(warm_speed, false);
    next->is = untouched;
    next->age_s = 0;
    next->press.steady = false;
    double likelihood;
    if (from.line.known)
        likelihood = update_baseline(*next);
    else {
        // Now it is seen from where the press before looked as it did.
        const auto was = from.press.motion.phase();
        likelihood = log_density(d_image->density(
                         { was[0] - d_group.phase[0], was[1] - d_group.phase[1] })) +
                     find_strength(*next, any_amplitude);
        reset_baseline(*next);
        next->line.known = true;
    }
    if (next->turn.goes_on) {
        start_motion(*next, true);
        next->press.motion.move(next->turn.velocity, next->turn.deviation());
    }
    give(*next, likelihood);
}

void press_filter::touch(const explanation& from,
                         double probability,
                         state is,
                         bool warms)
{
    auto* const next = follow(from, probability, d_contact_peak);
    if (!next)
        return;
    next->is = is;
    next->age_s = 0;
    next->turn.goes_on &= is == pressed;
    if (warms)
        next->turn.begin(warm_speed, false);
    begin_press(*next);
    if (next->turn.goes_on)
        next->press.motion.move(next->turn.velocity, next->turn.deviation());
    const double spread = is == pressed ? d_set.contact_np : any_amplitude;
    if (shows_turns(*next)) {
        const double amplitudes = begin_strength(*next, spread);
        give(*next, amplitudes + contact_phases(*next));
        return;
    }
    const double phases = contact_phases(*next);
    give(*next, may_count(*next, phases) ? phases + find_strength(*next, spread) : lost);
}

// A finger may warm the line from now on.
void press_filter::press(const explanation& from, double probability)
{
    const double warm = probability * warming_probability(from);
    touch(from, probability - warm, pressed);
    touch(from, warm, pressed, true);
}

// Beside a contact that the model does not contain, another one is as likely as a press.
void press_filter::exchange(const explanation& from, double probability)
{
    const double other = from.is == unexplained ? probability / 2 : 0;
    touch(from, other, unexplained);
    press(from, probability - other);
}

// A connector or a line of one end has changed: nobody touches, and the untouched line is
// another one from now on.
void press_filter::move_line(const explanation& from, double probability)
{
    if (!from.line.known)
        return;
    const double variance = sudden_turn_variance();
    auto* const next = follow(from, probability, phase_peak({ variance, variance }));
    if (!next)
        return;
    if (from.is != untouched)
        next->age_s = 0;
    next->is = untouched;
    next->turn.moved += learns_turns(from);
    move_cable(*next);
    next->line.amplitude.widen(moved_amplitudes());
    next->line.widen({ variance, variance, 0 });
    give(*next, update_baseline(*next));
}

void press_filter::move_cable(explanation& to)
{
    to.turn.goes_on = to.press.steady = false;
    to.turn.sudden = to.turn.parted = true;
}

// Variances of mean and difference of the amplitudes that a cable moves.
pair_of_ends press_filter::moved_amplitudes() const
{
    // Where the off states are to tell turns, another line of one end is unexplained.
    return { squared(d_set.turn_np), d_off_differ ? 0 : 4 * squared(d_set.turn_np) };
}

// The same while somebody presses: at one end, or at both.
void press_filter::move_beside_press(const explanation& from, double probability)
{
    if (!from.line.known)
        return;
    const double variance = sudden_turn_variance();
    for (const pair_of_ends& ends : { pair_of_ends{ 1, 0 }, { 0, 1 }, { 1, 1 } }) {
        const phase_covariance moved{ ends[0] * variance, ends[1] * variance };
        auto* const next = follow(from, probability / 3, phase_peak(moved));
        if (!next)
            continue;
        const auto moves = [&ends](const phase_covariance& each) {
            return phase_covariance{ ends[0] * each.first,
                                     ends[1] * each.second,
                                     ends[0] * ends[1] * each.both };
        };
        move_cable(*next);
        drift(*next);
        auto& motion = next->press.motion;
        motion.rest();
        const auto was = motion;
        motion.widen(moved);
        const double likelihood = motion.update(d_group.phase, d_noise);
        const auto is = motion.phase(), from_phase = was.phase();
        next->line.turn(
            { ends[0] * (is[0] - from_phase[0]), ends[1] * (is[1] - from_phase[1]) });
        // As beside a turn (follow_turn), of the ends that move.
        const auto error = moves(motion.covariance());
        next->line.widen(moves(was.covariance()));
        next->line.widen(moves(next->press.held.with()), -2);
        next->line.widen(error);
        next->hold_level();
        next->press.held.tie(error);
        give(*next, update_strength_while_turning(*next, likelihood, moved_amplitudes()));
    }
}

void press_filter::stop_changing(const explanation& from, double probability)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    next->press.motion.predict(d_elapsed_s);
    next->press.motion.stop(d_elapsed_s);
    next->age_s = 0;
    next->press.steady = false;
    drift(*next);
    const double likelihood = next->press.motion.update(d_group.phase, d_noise);
    next->hold_level();
    give(*next, update_strength(*next, likelihood + density_gained(*next, from)));
}

void press_filter::hold(const explanation& from, double probability)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    next->claimed = from.claimed;
    // What is held drifts as the untouched line does, and with it.
    auto& held = next->press.held;
    const double likelihood =
        held.carry(next->line, d_group.phase, d_noise, rate_memory());
    next->press.motion.hold(held.phase(), held.covariance());
    give(*next, update_strength(*next, likelihood), true);
}

void press_filter::change_steadily(const explanation& from,
                                   double probability,
                                   bool slides,
                                   std::size_t speed)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    if (!from.press.steady)
        next->age_s = 0;
    next->press.steady = true;
    next->press.slides = slides;
    next->press.speed = speed;
    drift(*next);
    const auto [direction, aside] = heading_of(from, slides);
    // The speed begins, or changes as much within a second.
    const double along = squared(speeds[speed]) * (from.press.steady ? d_elapsed_s : 1.0);
    next->press.motion.widen_velocity(covariance_along(direction, along, aside * along));
    if (from.turn.goes_on) { // by what it turned before, or by anything
        const double by = squared(turning_speed(from.turn.speed)) *
                          (from.turn.age_s == 0 ? 1 : d_elapsed_s);
        next->press.motion.widen_velocity({ by, by, by });
    }
    next->press.motion.predict(d_elapsed_s);
    const auto was = from.press.motion.phase();
    double likelihood = next->press.motion.update(d_group.phase, d_noise);
    next->hold_level();
    if (from.turn.goes_on)
        part_turn(*next, was, direction, aside);
    likelihood += density_gained(*next, from);
    if (!slides)
        bend(*next, from.press.heading);
    // How far the tag has turned is hardly known here; what a hand does to amplitudes is.
    give(*next,
         from.turn.goes_on && from.turn.by_hand
             ? update_strength_while_turning(
                   *next, likelihood, { hand_variance(from.turn.speed), 0 })
             : update_strength(*next, likelihood));
}

void press_filter::turn_and_change(const explanation& from,
                                   double probability,
                                   std::size_t speed,
                                   bool near)
{
    if (!may_count(from, std::log(probability) + d_peak))
        return;
    auto turning = from;
    turning.turn.begin(speed, near);
    count_turn(turning, from);
    go_on_changing(turning, probability);
}

// While the tag turns and the force changes: both phases are moved by the turn alike, and
// by the force in the direction of the press. In the middle of the line that is the same;
// an error of this division lasts for as long as the turn.
void press_filter::part_turn(explanation& to,
                             const pair_of_ends& was,
                             const pair_of_ends& direction,
                             double aside) const
{
    const auto is = to.press.motion.phase();
    const double expected = to.turn.velocity * d_elapsed_s;
    const double first = is[0] - was[0] - expected, second = is[1] - was[1] - expected;
    const double by_turn = squared(turning_speed(to.turn.speed) * d_elapsed_s),
                 by_force = squared(speeds[to.press.speed] * d_elapsed_s),
                 noise = d_noise.first / 100;
    const auto force = covariance_along(direction, by_force, aside * by_force);
    const double a = force.first + by_turn + noise, b = force.second + by_turn + noise,
                 ab = force.both + by_turn;
    const double determinant = a * b - ab * ab;
    const double turned = by_turn * ((b - ab) * first + (a - ab) * second) / determinant,
                 doubt = by_turn - squared(by_turn) * (a + b - 2 * ab) / determinant;
    to.line.common.turn(expected + turned);
    to.line.common.widen(std::max(doubt, 0.0) *
                         std::min(turn_duration_s(to), d_elapsed_s + 2 * to.turn.age_s) /
                         d_elapsed_s);
    to.turn.velocity += (1 - going_on(turn_duration_s(to))) * turned / d_elapsed_s;
}

// For a part of the group, in which the press changes: as before, or to rest.
void press_filter::turn_unseen(explanation& to, double part) const
{
    const double by = to.turn.velocity * d_elapsed_s,
                 bends =
                     squared(turning_speed(to.turn.speed) * d_elapsed_s) * d_elapsed_s;
    to.line.common.turn(part * by);
    to.line.common.widen(squared(by) / 12 + bends);
    if (!to.press.steady) // else its velocity holds that of the turn
        to.press.motion.turn({ part * by, part * by });
    if (to.turn.by_hand)
        for (auto* amplitudes : { &to.line.amplitude, &to.press.strength })
            amplitudes->mean_variance += part * hand_variance(to.turn.speed);
}

void press_filter::mix(const explanation& from, double probability, double ends)
{
    auto* const next = follow(from, probability);
    if (!next)
        return;
    next->mixture = mixture_after(from, ends);
    next->is = mixed;
    // A force that changes may go on through a group that is only partly received.
    if (next->press.steady)
        next->press.motion.predict(d_elapsed_s);
    if (next->turn.goes_on)
        turn_unseen(*next, 1);
    give(*next, log_any_mixture + next->mixture.log_density);
}

// What this group shows between the state before and the next one.
press_filter::mixture press_filter::mixture_after(const explanation& from,
                                                  double ends) const
{
    auto found = from.mixture;
    found.seen = d_seen.at(d_group.phase);
    found.seen_variance = d_difference_noise / 2;
    found.log_density = 0;
    if (from.is == mixed) {
        found.single = false;
        // Two groups that a press fills in part show the same press.
        if (from.mixture.single && found.before == untouched) {
            auto parts = found;
            parts.start = from.mixture.seen;
            const auto line = from.line.ratio();
            const auto changed = [&](const both_ends& seen) {
                return std::norm(seen[0] - line[0]) + std::norm(seen[1] - line[1]);
            };
            const double first = changed(parts.start), second = changed(parts.seen);
            if (first < second)
                std::swap(parts.start, parts.seen);
            parts.before = pressed;
            // Where the second lies farther out, the first says so much less where it is.
            found.log_density = log_sum(std::log(any_share),
                                        1.5 * std::log(std::min(first / second, 1.0)) +
                                            chord_to_line(parts, from, 0));
        }
        return found;
    }
    found.before = from.is;
    found.age_s = from.age_s;
    found.single = true;
    found.start = from.is == untouched
                      ? from.line.ratio()
                      : shown_strength(from).at(from.press.motion.phase());
    if (from.is == untouched)
        found.log_density = pressed_in_part(found);
    // Where a press ends, it is known what comes after.
    if (ends > 0 && from.line.known)
        found.log_density =
            log_sum(std::log(ends) + chord_to_line(found, from), std::log1p(-ends));
    return found;
}

} // namespace gr::wiforce::kernel
