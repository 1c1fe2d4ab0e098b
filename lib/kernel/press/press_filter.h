// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../phases/press_observation.h"
#include "explanation.h"
#include "off_states.h"
#include "press_image.h"
#include "press_parameters.h"

#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * \brief What a sensor has shown so far, as a few explanations with weights.
 *
 * docs/press.md explains it. Every explanation holds the phases that both ends would show
 * if nobody touched, and what the press is doing. With every group it branches into what
 * may have happened next, each branch is weighted by how well it predicts the group,
 * and those that one may stand for are merged.
 */
class press_filter
{
public:
    using outcome = press_outcome;
    using state = press_state;

    press_filter(std::shared_ptr<const press_image> image,
                 const press_parameters& settings,
                 const off_states& off);

    //! Whether amplitudes distinguish a turn of the tag from a press.
    bool off_states_differ() const { return d_off_differ; }
    //! Takes the next group that was received.
    void take(const press_observation& group);
    //! The next group shows what the receiver has done, but not the tag.
    void pass(const press_observation& group);
    //! The user says that the newest group is untouched, which is true with this
    //! probability; then its phases are those of the untouched line.
    void claim_untouched(double probability);
    //! Phases and amplitudes are counted from another reference: by how much those of the
    //! former one seem to have changed.
    void change_reference(const pair_of_ends& phase, const pair_of_ends& amplitude);

    //! Of the newest group, as far as is known yet, and of the one before it, now that
    //! its successor is known; largest weight first; of no group before the first.
    std::vector<outcome> newest() const;
    std::vector<outcome> before_newest() const;

private:
    using mixture = explanation::mixture_of_states;

    // Of any mixture, beside those whose states before and after are known.
    static constexpr double any_share = 0.25;

    enum class course { begins, goes_on, ends };

    // Probabilities in the time of a group.
    struct chances {
        double all;                // that the state changes:
        double unexplained, press; // to a contact beside the model, or otherwise,
        double release, exchange, steadily; // where it is touched
        double turns, hands, moves, bursts; // of the tag, cables, what hides the tag
        // That something is sudden (a cable may move the line, or phases beside it of a
        // touched sensor, each with `moves`); and the rest, in which changes begin that
        // last.
        double sudden, quiet;
    };

    // press_filter.cc: what may follow, and what is kept of it.
    void start(const press_observation& group);
    void observe(const press_observation& group);
    void predict(explanation& from);
    void suppose_untouched(double probability);
    void branch(const explanation& from);
    void branch_untouched(const explanation& from);
    void branch_touched(const explanation& from);
    void branch_mixed(const explanation& from);
    chances chances_of(const explanation& from) const;
    void branch_suddenly(const explanation& from, const chances& may, double share);
    void begin_turning(const explanation& from, const chances& may, double share);
    void begin_changing(const explanation& from, double probability);
    // Give the probability of coming to rest.
    double change_speed_of_press(const explanation& from, double probability);
    double change_speed_of_turn(const explanation& from, double probability);
    std::size_t fastest_turn() const;
    template <class Event>
    void with_courses(const explanation& from, Event&& event) const;
    double happens(double rate) const;
    static double happens(double rate, double seconds);
    double learned(double per_s, double seen, double time_s) const;
    double move_probability(const explanation& of) const;
    double burst_probability(const explanation& of) const;
    double fail_probability(const explanation& of) const;
    double turn_probability(const explanation& of, double seconds) const;
    double hand_probability(const explanation& of, double seconds) const;
    double warming_probability(const explanation& of) const;
    double sudden_turn_variance() const;
    double going_on(double mean_s) const;
    double duration_s(std::size_t speed) const;
    double turn_duration_s(const explanation& of) const;
    double lasting() const;
    double between_groups() const;
    void settle();
    void keep_claim();
    double loss_of_merging(const explanation& a, const explanation& b, double most) const;
    std::vector<outcome> collect(outcome explanation::*which) const;

    // press_events.cc: each event adds what follows `from` with this probability.
    void remain_untouched(const explanation& from, double probability);
    void touch(const explanation& from, double probability, state is, bool warms = false);
    void press(const explanation& from, double probability);
    void exchange(const explanation& from, double probability);
    void hold(const explanation& from, double probability);
    void change_steadily(const explanation& from,
                         double probability,
                         bool slides,
                         std::size_t speed);
    void go_on_changing(const explanation& from, double probability)
    {
        change_steadily(from, probability, from.press.slides, from.press.speed);
    }
    void stop_changing(const explanation& from, double probability);
    void release(const explanation& from, double probability);
    void leave(const explanation& from, double probability, bool cools);
    void move_line(const explanation& from, double probability);
    void move_beside_press(const explanation& from, double probability);
    void turn_suddenly(const explanation& from, double probability);
    void turn_slowly(const explanation& from,
                     double probability,
                     course how,
                     std::size_t speed,
                     bool near);
    // Begins while a force goes on changing.
    void turn_and_change(const explanation& from,
                         double probability,
                         std::size_t speed,
                         bool near);
    // Goes on, or ends, as it has begun.
    void turn_slowly(const explanation& from, double probability, course how)
    {
        turn_slowly(from, probability, how, from.turn.speed, from.turn.by_hand);
    }
    void mix(const explanation& from, double probability, double ends = 0);

    static void move_cable(explanation& to);
    pair_of_ends moved_amplitudes() const;
    void start_motion(explanation& to, bool begins) const;
    void count_turn(explanation& to, const explanation& from) const;
    double follow_turn(explanation& to, const phase_motion& was) const;
    void part_turn(explanation& to,
                   const pair_of_ends& was,
                   const pair_of_ends& direction,
                   double aside) const;
    void turn_unseen(explanation& to, double part) const;
    mixture mixture_after(const explanation& from, double ends) const;

    // press_likelihood.cc: what events share.
    void find_peaks();
    double phase_peak(const phase_covariance& by) const;
    bool may_count(const explanation& next, double log_phases) const;
    double least_phases(const explanation& next) const;
    explanation*
    follow(const explanation& from, double probability, double phase_peak = INFINITY);
    void give(explanation& next, double log_likelihood, bool lasts = false);
    void average(explanation& to, bool lasts) const;
    double step_probability() const;
    void step_receiver(explanation& to) const;
    void step_level(const explanation& from);

    // Phases of the untouched line, and of a press.
    void reset_baseline(explanation& to) const;
    double update_baseline(explanation& to) const;
    double rate_memory() const;
    double update_amplitude(explanation& of, both_amplitudes& own) const;
    void drift(explanation& to) const;
    void begin_press(explanation& to) const;
    void reset_strength(explanation& to) const;
    void look_up(explanation& of) const;
    double density_gained(explanation& to, const explanation& from) const;
    press_image::heading heading_of(const explanation& of, bool slides) const;
    void bend(explanation& to, const press_image::heading& was) const;
    double density(const explanation& of, const pair_of_ends& phase) const;
    double contact_phases(const explanation& of) const;

    // Amplitudes, and what shows in them: hands, turns, off states.
    double turning_speed(std::size_t speed) const;
    double hand_variance(std::size_t speed) const;
    double find_strength(explanation& to, double spread) const;
    double update_strength(explanation& to, double log_phases) const;
    double update_strength_while_turning(explanation& to,
                                         double log_phases,
                                         const pair_of_ends& variances) const;
    double update_from_off_states(explanation& to) const;
    double begin_strength(explanation& to, double spread) const;
    double update_mean(explanation& of, both_amplitudes& own, double seen) const;
    pair_of_ends caused_by_off(const explanation& of, const pair_of_ends& phase) const;
    bool shows_turns(const explanation& of) const;
    bool learns_turns(const explanation& of) const;
    both_amplitudes shown_strength(const explanation& of) const;
    both_amplitudes seen_beside(const pair_of_ends& caused) const;

    // Groups in which something changes.
    static double chord(const mixture& seen,
                        const both_ends& to,
                        state after,
                        double variance,
                        double any = any_share);
    static double
    chord_to_line(const mixture& seen, const explanation& of, double any = any_share);
    double pressed_in_part(const mixture& from) const;
    outcome describe(const explanation& of) const;

    std::shared_ptr<const press_image> d_image;
    press_parameters d_set;
    off_states d_off;
    bool d_off_differ;
    double d_negligible;   // logarithm of a weight that is not followed
    double d_contact_peak; // largest log density of the phases of contacts
    std::vector<explanation> d_kept, d_next;
    double d_best = 0;    // largest log weight so far
    double d_claimed = 0; // probability of what the user has said
    // Largest log densities of a group's phases, and of its amplitudes.
    double d_peak = 0, d_amplitude_peak = 0;

    press_observation d_group;
    bool d_first = true;        // nothing was seen before it
    press_observation d_passed; // what the receiver has done since
    bool d_silent = false;      // the tag was not received just before the group
    double d_elapsed_s = 0;     // since the group before
    double d_lasted_s = 0;      // since the first
    phase_covariance d_noise;
    double d_common_noise = 0, d_difference_noise = 0;
    both_amplitudes d_seen; // as if nothing but the group were known
};

} // namespace gr::wiforce::kernel
