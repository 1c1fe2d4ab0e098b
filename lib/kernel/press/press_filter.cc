// SPDX-License-Identifier: GPL-3.0-or-later
// What may have happened, and which of it is kept.
#include "press_filter.h"
#include "press_terms.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// Of the second in the weight of both.
double share_of(const explanation& a, const explanation& b)
{
    return 1 / (1 + std::exp(a.log_weight - b.log_weight));
}

// Of one explanation with the mean and the variance of two in place of both.
class merging_loss
{
public:
    explicit merging_loss(double share) : d_share(share) {}

    void compare(double apart, double of_first, double of_second)
    {
        const double all = of_first + d_share * (of_second - of_first) +
                           d_share * (1 - d_share) * squared(apart);
        d_first_wider *= all / of_first;
        d_second_wider *= all / of_second;
        d_first += (of_first + squared(d_share * apart)) / all - 1;
        d_second += (of_second + squared((1 - d_share) * apart)) / all - 1;
    }

    //! How much of the evidence for the one that loses more of it is lost, in nats: its
    //! divergence, less what it gains of the weight of the other.
    double nats() const
    {
        return std::max(first() + std::log1p(-d_share), second() + std::log(d_share));
    }
    double divergence() const { return std::max(first(), second()); }
    //! Of both together, by their weights.
    double mean() const { return (1 - d_share) * first() + d_share * second(); }

private:
    double first() const { return (d_first + std::log(d_first_wider)) / 2; }
    double second() const { return (d_second + std::log(d_second_wider)) / 2; }

    double d_share, d_first = 0, d_second = 0;
    // By how much all variances together are larger.
    double d_first_wider = 1, d_second_wider = 1;
};

// What decides what comes next: one explanation may stand for two of a kind.
std::uint64_t kind_of(const explanation& of)
{
    static_assert(turn_speeds.size() < 8 && speeds.size() < 16, "four bits each");
    const auto& [turn, press, mixture] = std::tie(of.turn, of.press, of.mixture);
    std::uint64_t kind = 0;
    for (std::size_t each : { std::size_t(of.is),
                              std::size_t(of.line.known),
                              std::size_t(of.claimed),
                              std::size_t(of.last.is),
                              std::size_t(of.last.known),
                              turn.goes_on ? 2 + 2 * turn.speed + turn.by_hand : 0,
                              press.steady ? 1 + press.speed : 0,
                              std::size_t(press.steady && press.slides),
                              of.is == mixed ? std::size_t(mixture.before) : 0,
                              std::size_t(of.is == mixed && mixture.single) })
        kind = 16 * kind + each;
    return kind;
}

// What the receiver has done in another group too.
void add_receiver(press_observation& to, const press_observation& other)
{
    to.receiver_phase += other.receiver_phase;
    to.receiver_amplitude += other.receiver_amplitude;
    to.receiver_variance += other.receiver_variance;
    to.retuned |= other.retuned;
}

// What readings cannot tell apart.
bool reads_alike(const press_outcome& a, const press_outcome& b)
{
    if (a.is != b.is || a.known != b.known)
        return false;
    const auto& noise = a.mean.variance;
    const double both = noise[0] + noise[1];
    merging_loss loss(b.weight / (a.weight + b.weight));
    for (const auto& [common, difference] : { a.apart(b), a.seen_apart(b) }) {
        loss.compare(common, a.common_variance + both / 4, b.common_variance + both / 4);
        loss.compare(
            difference, a.difference_variance + both, b.difference_variance + both);
    }
    return loss.divergence() < no_loss;
}

} // namespace

press_filter::press_filter(std::shared_ptr<const press_image> image,
                           const press_parameters& settings,
                           const off_states& off)
    : d_image(std::move(image)),
      d_set(settings),
      d_off(off),
      d_off_differ(off.differ(settings.contact_np)),
      d_negligible(std::log(std::min(settings.rarest * settings.period_s, least_weight))),
      d_contact_peak(std::max(log_any_phases, log_density(d_image->largest_density())))
{
}

void press_filter::pass(const press_observation& group)
{
    add_receiver(d_passed, group);
    d_silent = true;
}

void press_filter::take(const press_observation& group)
{
    observe(group);
    d_next.clear();
    d_best = lost;
    if (d_first)
        start(group);
    const double steps = step_probability();
    for (auto& from : d_kept) {
        predict(from);
        look_up(from);
        const double log_weight = from.log_weight;
        if (steps < 1) {
            from.log_weight = log_weight + std::log1p(-steps);
            step_level(from);
            branch(from);
        }
        from.log_weight = log_weight;
        if (steps > 0 && may_count(from, std::log(steps) + d_peak)) {
            from.log_weight = log_weight + std::log(steps);
            step_receiver(from);
            look_up(from);
            branch(from);
        }
    }
    settle();
    d_silent = false;
}

void press_filter::observe(const press_observation& group)
{
    d_first = d_kept.empty();
    d_elapsed_s = d_first ? 0 : group.time_s - d_group.time_s;
    d_lasted_s += d_elapsed_s;
    d_group = group;
    add_receiver(d_group, d_passed);
    d_group.receiver_variance =
        std::max(d_group.receiver_variance, least_receiver_variance);
    d_passed = {};
    const auto& noise = group.variance;
    const double floor = squared(d_set.phase_deg * deg);
    d_noise = { noise[0] + floor + group.common_variance,
                noise[1] + floor + group.common_variance,
                group.common_variance };
    d_difference_noise = d_noise.of_difference();
    d_common_noise = d_noise.of_mean();
    const double each = (noise[0] + noise[1]) / 4 + squared(d_set.amplitude_np) / 2;
    d_seen = { 0, 0, each, 4 * each };
    d_seen.grow(group.amplitude);
    find_peaks();
}

// What is known of an explanation in this group before the group is seen.
void press_filter::predict(explanation& from)
{
    from.line.predict(d_elapsed_s);
    from.press.held.predict(d_elapsed_s);
    const double fades = squared(d_set.fading_np) * d_elapsed_s;
    for (auto* amplitudes : { &from.line.amplitude, &from.press.strength }) {
        amplitudes->mean_variance += fades;
        // What fades is the way to the tag, which both ends share.
        amplitudes->difference_variance += d_off_differ ? 0 : fades;
    }
    from.age_s += d_elapsed_s;
    from.turn.age_s += d_elapsed_s;
    from.turn.sudden = from.turn.parted = false;
    from.turn.failed += d_silent;
    from.turn.watched_s += learns_turns(from) ? d_elapsed_s : 0;
    const double fails = fail_probability(from);
    from.log_fails = std::log(fails);
    from.log_works = std::log1p(-fails);
}

void press_filter::start(const press_observation& group)
{
    const double rate = d_set.drift_deg * deg; // negative to learn it
    auto& first = d_next.emplace_back();
    // Both ends drift by themselves: their mean by less, their difference by more.
    first.line.common = drift_bank(std::sqrt(0.5), rate);
    first.line.difference = drift_bank(std::sqrt(2.0), rate);
    reset_baseline(first);
    const double sure = group.untouched > 0 ? group.untouched : 0.5;
    first.log_weight = std::log(sure);
    give(first, 0);
    // A press that began before the first group: the untouched line is unknown.
    auto& touched = d_next.emplace_back(d_next.back());
    touched.is = pressed;
    touched.line.known = false;
    touched.log_weight = std::log1p(-sure);
    begin_press(touched);
    reset_strength(touched);
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

press_filter::chances press_filter::chances_of(const explanation& from) const
{
    const bool touched = from.touched();
    const double age_s = from.is == mixed ? from.mixture.age_s : from.age_s,
                 doubt = from.is == untouched ? 1 - d_group.untouched : 1;
    chances may;
    may.all = doubt * d_elapsed_s / (age_s + d_set.settling_s);
    may.unexplained = d_set.unexplained * may.all;
    may.press = may.all - may.unexplained;
    may.release = d_set.release * may.all;
    may.exchange = d_set.exchange * may.all;
    may.steadily = touched ? std::max(may.press - may.release - may.exchange, 0.0) : 0;
    may.turns = turn_probability(from, d_elapsed_s);
    may.hands = hand_probability(from, d_elapsed_s);
    may.moves = move_probability(from);
    may.bursts = burst_probability(from);
    may.sudden =
        may.all - may.steadily + may.turns + (touched ? 2 : 1) * may.moves + may.bursts;
    may.quiet = std::max(1 - may.sudden, 1e-3);
    return may;
}

// The sudden events that are the same in all states: the tag turns, a contact begins that
// the model does not contain, a cable moves.
void press_filter::branch_suddenly(const explanation& from,
                                   const chances& may,
                                   double share)
{
    turn_suddenly(from, share * may.turns);
    touch(from, share * may.unexplained, unexplained);
    move_line(from, share * may.moves);
    if (from.touched())
        move_beside_press(from, share * may.moves);
}

// What the tag may do while the press changes: nothing, or turn suddenly, or a hand moves
// near it; or go on turning, or come to rest. Calls `event` with the tag and with the
// probability of that.
template <class Event>
void press_filter::with_courses(const explanation& from, Event&& event) const
{
    const auto course = [&](double share, const auto& changed) {
        auto other = from;
        changed(other);
        event(other, share);
    };
    if (from.turn.goes_on) {
        const double goes_on = going_on(turn_duration_s(from));
        course(goes_on, [&](explanation& other) { turn_unseen(other, 1); });
        course(1 - goes_on, [&](explanation& other) {
            turn_unseen(other, 0.5);
            other.turn.goes_on = false;
        });
        return;
    }
    // While it changed, in all groups of that.
    const double within_s =
        d_elapsed_s + (from.is == mixed ? from.age_s - from.mixture.age_s : 0);
    const double turns = turn_probability(from, within_s),
                 hands = hand_probability(from, within_s);
    const auto widen = [](explanation& other, double phase, double amplitude) {
        other.line.common.widen(phase);
        other.line.amplitude.mean_variance += amplitude;
    };
    event(from, 1 - turns - hands);
    course(turns, [&](explanation& other) {
        other.turn.sudden = true;
        widen(other, sudden_turn_variance(), squared(d_set.turn_np));
    });
    for (std::size_t i = 1; i <= hand_speeds; i++)
        course(hands / hand_speeds, [&](explanation& other) {
            widen(other, hand_variance(i), hand_variance(i));
        });
}

void press_filter::branch_untouched(const explanation& from)
{
    const auto may = chances_of(from);
    const double goes_on = going_on(turn_duration_s(from)), between = between_groups();
    if (from.turn.goes_on) {
        turn_slowly(from, may.quiet * goes_on, course::goes_on);
        turn_slowly(
            from, change_speed_of_turn(from, may.quiet * (1 - goes_on)), course::ends);
    } else {
        remain_untouched(from, may.quiet * (1 - may.turns - may.hands));
        begin_turning(from, may, may.quiet);
    }
    branch_suddenly(from, may, between);
    with_courses(from, [&](const explanation& tag, double share) {
        press(tag, between * may.press * share);
    });
    mix(from, (1 - between) * may.sudden);
}

void press_filter::branch_touched(const explanation& from)
{
    const auto may = chances_of(from);
    const double turns_on = going_on(turn_duration_s(from)),
                 changes_on =
                     from.press.steady ? going_on(duration_s(from.press.speed)) : 0,
                 begins = may.steadily / std::max(may.quiet, may.steadily),
                 between = between_groups();
    if (from.turn.goes_on && from.press.steady) {
        // Both go on, or one of them ends, or both.
        go_on_changing(from, may.quiet * turns_on * changes_on);
        auto resting = from, held = from;
        resting.turn.goes_on = false;
        resting.press.motion.push(-from.turn.velocity);
        go_on_changing(resting, may.quiet * (1 - turns_on) * changes_on);
        held.press.steady = false;
        held.press.motion.move(from.turn.velocity, turning_speed(from.turn.speed));
        held.mean.weight = {};
        held.age_s = 0;
        turn_slowly(held,
                    change_speed_of_press(from, may.quiet * turns_on * (1 - changes_on)),
                    course::goes_on);
        auto both = from;
        turn_unseen(both, 0.5);
        both.turn.goes_on = false;
        stop_changing(both, may.quiet * (1 - turns_on) * (1 - changes_on));
    } else if (from.turn.goes_on) {
        turn_slowly(from, may.quiet * turns_on * (1 - begins), course::goes_on);
        turn_slowly(
            from, change_speed_of_turn(from, may.quiet * (1 - turns_on)), course::ends);
        begin_changing(from, may.quiet * turns_on * begins);
    } else if (from.press.steady) {
        go_on_changing(from, may.quiet * changes_on * (1 - may.turns - may.hands));
        begin_turning(from, may, may.quiet * changes_on);
        stop_changing(from, change_speed_of_press(from, may.quiet * (1 - changes_on)));
    } else {
        const double rests = may.quiet * (1 - begins);
        hold(from, rests * (1 - may.turns - may.hands));
        begin_changing(from, may.quiet * begins);
        begin_turning(from, may, rests);
    }
    branch_suddenly(from, may, between);
    with_courses(from, [&](const explanation& tag, double share) {
        release(tag, between * may.release * share);
        exchange(tag, between * may.exchange * share);
    });
    mix(from, (1 - between) * may.sudden, may.release / may.sudden);
}

void press_filter::branch_mixed(const explanation& from)
{
    const auto may = chances_of(from);
    const auto& mixture = from.mixture;
    const bool touched = from.touched(), single = mixture.single;
    // The change lasts, or another one follows it at once.
    const double goes_on = single ? lasting() : going_on(d_set.change_s),
                 another = (1 - between_groups()) * d_elapsed_s / d_set.settling_s,
                 lasts = goes_on + (1 - goes_on) * another,
                 ends = (1 - lasts) / may.sudden;
    // What was seen of a single group of change lies between the states before and after
    // it.
    const double known = single ? mixture.log_density : 0;
    const double to_this =
        single
            ? chord(mixture, d_seen.at(d_group.phase), pressed, d_difference_noise / 2) -
                  known
            : 0;
    auto next = from;
    next.is = mixture.before;
    next.age_s = mixture.age_s;
    next.log_weight = from.log_weight + to_this;
    branch_suddenly(next, may, ends);
    // What was seen was not the tag.
    next.log_weight = from.log_weight - known;
    next.mean.weight = {};
    next.turn.bursts++;
    if (next.turn.goes_on)
        turn_slowly(next, ends * may.bursts, course::goes_on);
    else if (!touched)
        remain_untouched(next, ends * may.bursts);
    else if (next.press.steady)
        go_on_changing(next, ends * may.bursts);
    else
        hold(next, ends * may.bursts);
    with_courses(from, [&](const explanation& tag, double share) {
        const double to_untouched = single && !touched ? 0
                                    : single && tag.line.known && !tag.turn.sudden
                                        ? chord_to_line(mixture, tag) - known
                                        : to_this;
        next = tag;
        next.is = mixture.before;
        next.log_weight = tag.log_weight + to_untouched;
        // Without a press before it was a tap.
        release(next, ends * (touched ? may.release : 0.1 * may.press) * share);
        next.log_weight = tag.log_weight + to_this;
        exchange(next, ends * (touched ? may.exchange : 0.9 * may.press) * share);
    });
    mix(from, lasts);
}

void press_filter::begin_turning(const explanation& from,
                                 const chances& may,
                                 double share)
{
    const auto begin = [&](double probability, std::size_t speed, bool near) {
        if (from.press.steady)
            turn_and_change(from, probability, speed, near);
        else
            turn_slowly(from, probability, course::begins, speed, near);
    };
    const std::size_t last = fastest_turn();
    for (std::size_t i = 1; i <= last; i++) {
        begin(share * may.turns / static_cast<double>(last), i, false);
        if (i <= hand_speeds)
            begin(share * may.hands / hand_speeds, i, true);
    }
}

void press_filter::begin_changing(const explanation& from, double probability)
{
    const double each = probability / speeds.size();
    for (std::size_t i = 0; i < speeds.size(); i++) {
        const double slides = i > 0 ? sliding : 0; // what creeps stays where it is
        change_steadily(from, (1 - slides) * each, false, i);
        change_steadily(from, slides * each, true, i);
    }
}

namespace {

// What ends, of all speeds from the first to the last: half of those that can go on
// slower or faster, do. Gives the probability of coming to rest.
template <class Speed>
double change_speed(double probability,
                    std::size_t speed,
                    std::size_t first,
                    std::size_t last,
                    Speed&& go_on)
{
    const double each = probability / 4;
    double rests = probability;
    if (speed > first) {
        go_on(speed - 1, each);
        rests -= each;
    }
    if (speed < last) {
        go_on(speed + 1, each);
        rests -= each;
    }
    return rests;
}

} // namespace

double press_filter::change_speed_of_press(const explanation& from, double probability)
{
    const bool slides = from.press.slides;
    return change_speed(probability,
                        from.press.speed,
                        slides,
                        speeds.size() - 1,
                        [&](std::size_t speed, double each) {
                            change_steadily(from, each, slides, speed);
                        });
}

double press_filter::change_speed_of_turn(const explanation& from, double probability)
{
    const auto [at, near] = std::pair(from.turn.speed, from.turn.by_hand);
    if (at == warm_speed)
        return probability;
    return change_speed(probability,
                        at,
                        slow_turn,
                        near ? hand_speeds : fastest_turn(),
                        [&](std::size_t speed, double each) {
                            turn_slowly(from, each, course::goes_on, speed, near);
                        });
}

// The fastest is a sudden turn where a group may hold all of it.
std::size_t press_filter::fastest_turn() const
{
    const bool fast = turn_speeds[fast_turn] * d_set.period_s < d_set.turn_deg * deg;
    return fast ? fast_turn : fast_turn - 1;
}

// Of what has this rate, that it happens in the time of a group.
double press_filter::happens(double rate) const { return happens(rate, d_elapsed_s); }

double press_filter::happens(double rate, double seconds)
{
    return -std::expm1(-rate * seconds);
}

// Half of the turns are sudden.
double press_filter::turn_probability(const explanation& of, double seconds) const
{
    const double rate = d_set.turns_per_s >= 0
                            ? d_set.turns_per_s
                            : learned(d_set.turns, of.turn.seen, of.turn.watched_s);
    return happens(rate / 2, seconds);
}

// That a contact begins to warm the line, or a release to let it cool.
double press_filter::warming_probability(const explanation& of) const
{
    return of.turn.goes_on || d_set.drift_deg == 0 ? 0 : warming;
}

// That a hand comes near, and the tag does not turn by itself.
double press_filter::hand_probability(const explanation& of, double seconds) const
{
    return (1 - turn_probability(of, seconds)) *
           happens(learned(d_set.hands, of.turn.hands, of.turn.watched_s), seconds);
}

double press_filter::move_probability(const explanation& of) const
{
    return happens(learned(d_set.steps, of.turn.moved, of.turn.watched_s));
}

// That something that is not the tag hides it.
double press_filter::burst_probability(const explanation& of) const
{
    return happens(learned(d_set.steps, of.turn.bursts, d_lasted_s));
}

// That the tag was received in a part of the group only.
double press_filter::fail_probability(const explanation& of) const
{
    return d_silent ? part_silent
                    : happens(learned(d_set.steps, of.turn.failed, d_lasted_s),
                              d_set.period_s);
}

// Rate of what was expected at a rate of its own, and was seen so often in this time.
double press_filter::learned(double per_s, double seen, double time_s) const
{
    return (per_s * d_set.expected_s + seen) / (d_set.expected_s + time_s);
}

// Of a sudden change that began at any time in a group, that the group ends before it.
double press_filter::lasting() const
{
    const double changes = d_elapsed_s / d_set.change_s;
    return -std::expm1(-changes) / changes;
}

// Of a sudden change, that it is not seen inside a group: it happened at its begin, or
// while nothing was received.
double press_filter::between_groups() const
{
    const double inside = d_set.period_s / (d_set.period_s + unseen_s);
    return 1 - inside * d_set.period_s / d_elapsed_s;
}

// rad^2; of a line that a cable moves as well.
double press_filter::sudden_turn_variance() const
{
    return squared(d_set.turn_deg * deg);
}

// Mean time that a press that changes at one of the speeds goes on.
double press_filter::duration_s(std::size_t speed) const
{
    return d_set.steady_deg * deg / speeds[speed];
}

double press_filter::turn_duration_s(const explanation& of) const
{
    if (!of.turn.goes_on)
        return d_set.steady_s;
    return of.turn.speed == warm_speed  ? warm_s
           : of.turn.speed == fast_turn ? d_set.change_s
                                        : d_set.steady_s;
}

// That what goes on for this time on average does so through the group.
double press_filter::going_on(double mean_s) const
{
    return std::exp(-d_elapsed_s / mean_s);
}

// ---- keeping the likely ones

void press_filter::settle()
{
    std::vector<const explanation*> likely;
    for (const auto& next : d_next)
        likely.push_back(&next);
    std::sort(likely.begin(), likely.end(), [](const auto* a, const auto* b) {
        return a->log_weight > b->log_weight;
    });
    d_kept.clear();
    std::vector<std::uint64_t> kinds;
    for (const auto* each : likely) {
        const auto& next = *each;
        // All of its evidence is lost where it is dropped.
        const double counts = next.log_weight - d_best - d_negligible;
        if (counts < 0)
            break;
        const bool full = d_kept.size() == most_kept;
        const double most = full ? counts : no_loss;
        double least = INFINITY;
        explanation* with = nullptr;
        const auto kind = kind_of(next);
        for (std::size_t i = 0; i < kinds.size(); i++) {
            if (kinds[i] != kind)
                continue;
            const double loss = loss_of_merging(d_kept[i], next, most);
            if (loss < least) {
                least = loss;
                with = &d_kept[i];
            }
        }
        if (with)
            with->merge(next, share_of(*with, next));
        else if (!full) {
            d_kept.push_back(next);
            kinds.push_back(kind);
        }
    }
    double total = 0;
    for (const auto& kept : d_kept)
        total += std::exp(kept.log_weight - d_best);
    for (auto& kept : d_kept)
        kept.log_weight -= d_best + std::log(total);
    keep_claim();
}

// An untouched line and a press that is held where it lies predict the same, for as long
// as nothing happens: only what happens decides between them.
void press_filter::keep_claim()
{
    double untouched_weight = 0, held_weight = 0;
    for (const auto& kept : d_kept)
        if (kept.claimed)
            (kept.is == untouched ? untouched_weight : held_weight) +=
                std::exp(kept.log_weight);
    if (untouched_weight == 0 || held_weight == 0)
        return;
    const double both = untouched_weight + held_weight;
    for (auto& kept : d_kept)
        if (kept.claimed)
            kept.log_weight +=
                std::log(both * (kept.is == untouched ? d_claimed / untouched_weight
                                                      : (1 - d_claimed) / held_weight));
}

// How far one explanation lies from both in whose place it is; infinity where more than
// `most` nats of the evidence for either are lost. What loses none may merge with
// several: not with one that is so much wider that it hides it, and would grow narrower
// each time.
double press_filter::loss_of_merging(const explanation& a,
                                     const explanation& b,
                                     double most) const
{
    merging_loss loss(share_of(a, b));
    const auto compare = [&](double apart, double of_a, double of_b, double noise) {
        loss.compare(apart, of_a + noise, of_b + noise);
    };
    const auto compare_amplitudes = [&](const both_amplitudes& x,
                                        const both_amplitudes& y) {
        compare(y.mean - x.mean, x.mean_variance, y.mean_variance, d_seen.mean_variance);
        compare(y.difference - x.difference,
                x.difference_variance,
                y.difference_variance,
                d_seen.difference_variance);
    };
    if (a.line.known) {
        const auto x = a.line.common.estimate(), y = b.line.common.estimate();
        compare(wrapped(y.mean - x.mean), x.variance, y.variance, d_common_noise);
        const auto u = a.line.difference.estimate(), v = b.line.difference.estimate();
        compare(wrapped(v.mean - u.mean), u.variance, v.variance, d_difference_noise);
        compare_amplitudes(a.line.amplitude, b.line.amplitude);
    }
    if (loss.nats() > most)
        return INFINITY;
    if (a.touched() || a.turn.goes_on) {
        const auto x = a.press.motion.means(), y = b.press.motion.means(),
                   u = a.press.motion.variances(), v = b.press.motion.variances();
        compare(wrapped(y[0] - x[0]), u[0], v[0], d_common_noise);
        compare(wrapped(y[1] - x[1]), u[1], v[1], d_difference_noise);
        const double lasts2 =
            squared(a.press.steady ? duration_s(a.press.speed) : turn_duration_s(a));
        compare(y[2] - x[2], u[2], v[2], d_common_noise / lasts2);
        compare(y[3] - x[3], u[3], v[3], d_difference_noise / lasts2);
        compare_amplitudes(a.press.strength, b.press.strength);
    }
    if (a.is == mixed && a.mixture.single)
        for (int e = 0; e < 2; e++) {
            const auto apart = b.mixture.start[e] / a.mixture.start[e] - 1.0;
            compare(apart.real(), 0, 0, a.mixture.seen_variance);
            compare(apart.imag(), 0, 0, a.mixture.seen_variance);
        }
    return loss.nats() < most ? loss.mean() : INFINITY;
}

std::vector<press_filter::outcome>
press_filter::collect(outcome explanation::*which) const
{
    std::vector<outcome> found;
    for (const auto& kept : d_kept) {
        auto what = kept.*which;
        what.weight = std::exp(kept.log_weight);
        const auto same =
            std::find_if(found.begin(), found.end(), [&](const auto& other) {
                return reads_alike(other, what);
            });
        if (same == found.end()) {
            found.push_back(what);
            continue;
        }
        same->merge(what, what.weight / (same->weight + what.weight));
        same->weight += what.weight;
    }
    found.erase(
        std::remove_if(found.begin(),
                       found.end(),
                       [](const auto& each) { return each.weight < least_weight; }),
        found.end());
    std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
        return a.weight > b.weight;
    });
    return found;
}

std::vector<press_filter::outcome> press_filter::newest() const
{
    return collect(&explanation::now);
}

std::vector<press_filter::outcome> press_filter::before_newest() const
{
    return d_first ? std::vector<outcome>{} : collect(&explanation::last);
}

void press_filter::claim_untouched(double probability)
{
    if (d_kept.empty())
        return;
    double already = 0;
    for (const auto& kept : d_kept)
        already += kept.is == untouched ? std::exp(kept.log_weight) : 0;
    if (already < 0.5) {
        suppose_untouched(probability);
        return;
    }
    // What the user says is worth so much, however often it is said.
    const double sure = std::max(already, probability);
    d_claimed = std::max(d_claimed, probability);
    for (auto& kept : d_kept)
        kept.log_weight += kept.is == untouched
                               ? std::log(sure / already)
                               : std::log((1 - sure) / std::max(1 - already, 1e-12));
}

// It looked touched: the phases of the untouched line would be those of the newest group.
void press_filter::suppose_untouched(double probability)
{
    explanation next = d_kept.front();
    const auto strength = shown_strength(next);
    const bool held =
        (next.is == pressed || next.is == unexplained) && !next.press.steady;
    next.is = untouched;
    next.line.known = true;
    next.turn.goes_on = next.press.steady = false;
    reset_baseline(next);
    if (held) {
        next.line.reset(next.press.motion.phase(), next.press.motion.covariance());
        next.line.amplitude = strength;
    } else
        next.age_s = 0;
    next.now = describe(next);
    // If it is true, nothing changes any more; so it is compared with a press, or with
    // whatever changed the group, that rests.
    for (auto& kept : d_kept) {
        kept.log_weight += std::log1p(-probability);
        kept.claimed = kept.is != untouched;
        if (kept.is == mixed) {
            kept.is = unexplained;
            kept.turn.goes_on = false;
            begin_press(kept);
            reset_strength(kept);
        } else if (kept.press.steady)
            kept.hold_level();
        else
            continue;
        kept.press.steady = false;
        kept.age_s = 0;
    }
    next.claimed = true;
    d_claimed = probability;
    next.log_weight = std::log(probability);
    d_kept.insert(d_kept.begin(), next);
}

void press_filter::change_reference(const pair_of_ends& phase, const pair_of_ends& by)
{
    for (int e = 0; e < 2; e++) {
        d_group.phase[e] += phase[e];
        d_group.amplitude[e] += by[e];
    }
    d_seen.grow(by);
    for (auto& kept : d_kept) {
        kept.recount(phase, by);
        kept.now.recount(phase, by);
        kept.last.recount(phase, by);
    }
}

} // namespace gr::wiforce::kernel
