// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "drift_bank.h"
#include "phase_motion.h"
#include "press_image.h"

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>

namespace gr::wiforce::kernel {

using both_ends = std::array<std::complex<double>, 2>;

//! States of a sensor.
enum press_state {
    untouched,
    pressed,     // as the model has it
    unexplained, // touched, but not by any press of the model
    mixed,       // something changed inside the group
    press_states // how many there are
};

//! Phases and amplitudes of both ends, averaged for as long as nothing changes.
struct average_of_groups {
    pair_of_ends phase{}, amplitude{}, variance{}; // rad, Np, of each
    pair_of_ends weight{};                         // of the groups before

    void recount(const pair_of_ends& by, const pair_of_ends& gain);
};

//! What an explanation says of one group.
struct press_outcome {
    std::int64_t row = 0; // of the group in its batch
    double weight = 0;
    press_state is = untouched;
    // Whether the untouched line is; a first press may have begun before the first group.
    bool known = true;
    // Probability that the tag turns faster than `slow_turn`, or a cable moves; and that
    // the tag was received in a part of the group only.
    double turns = 0, in_part = 0;
    pair_of_ends baseline{}, amplitude{}; // of the untouched line, rad and Np
    // Of its mean phase, of its difference, and of the errors of both.
    double common_variance = 0, difference_variance = 0, covariance = 0;
    average_of_groups mean; // of what was received

    //! Mean and difference of how far the untouched line of another lies beside its own,
    //! and its mean phases.
    pair_of_ends apart(const press_outcome& other) const;
    pair_of_ends seen_apart(const press_outcome& other) const;
    //! Become one with another, whose share this is, but for what was received.
    void merge(const press_outcome& other, double share);
    //! Counted from where everything has turned and grown by this.
    void recount(const pair_of_ends& phase, const pair_of_ends& gain);
};

//! Phases of both ends, rad, whose mean and difference drift, each by itself; their
//! errors are correlated where one end is noisier.
struct drifting_phases {
    drift_bank common, difference;
    double both = 0; // covariance of these errors

    pair_of_ends phase() const;
    phase_covariance covariance() const;
    //! Of the errors of mean and difference; some events change the variance of one only.
    double of_errors() const;
    //! Begin at phases; what is known of the rates stays.
    void reset(const pair_of_ends& phase, const phase_covariance& covariance);
    void turn(const pair_of_ends& by);
    void widen(const phase_covariance& by, double times = 1);
    //! Covariance with those that they carry, and what both moved by, unknown alike.
    phase_covariance with() const;
    void tie(const phase_covariance& by);
    void predict(double seconds);
    //! By how much they drift in this time.
    phase_covariance walk(double seconds) const;
    //! Take phases with this noise; give the log density that was expected of them, or
    //! `lowest` where it is less.
    double update(const pair_of_ends& phase,
                  const phase_covariance& noise,
                  double memory,
                  double lowest);
    //! Likewise, of phases in which something drifts beside these of the line.
    double carry(drifting_phases& line,
                 const pair_of_ends& phase,
                 const phase_covariance& noise,
                 double memory);
    void merge(const drifting_phases& other, double share);

private:
    struct seen_phases {
        drift_bank::observation mean, difference;
        double both; // covariance of the errors afterwards
    };
    seen_phases beside(const pair_of_ends& phase, const phase_covariance& noise) const;
};

//! Mean and difference of the logarithms of both amplitudes, Np.
struct both_amplitudes {
    double mean = 0, difference = 0, mean_variance = 0, difference_variance = 0;

    pair_of_ends ends() const { return { mean + difference / 2, mean - difference / 2 }; }
    //! Ratios of these amplitudes.
    both_ends at(const pair_of_ends& phase) const;
    void grow(const pair_of_ends& by);
    //! By variances of the mean and of the difference.
    void widen(const pair_of_ends& by)
    {
        mean_variance += by[0];
        difference_variance += by[1];
    }
    void merge(const both_amplitudes& other, double share);
    //! Take what is seen; give the log density that was expected.
    double update_mean(double seen, double noise);
    double update_difference(double seen, double noise);
};

/*!
 * \brief What may have happened to a sensor up to now, and how likely that is.
 *
 * Each part says what it is about. They depend on each other where a held press drifts or
 * turns with its line (drift_bank::with), and where off states differ
 * (held_or_moving::with_common).
 */
struct explanation {
    double log_weight = 0;
    press_state is = untouched;
    double age_s = 0; // of the state

    //! What would be received if nobody touched.
    struct untouched_line : drifting_phases {
        both_amplitudes amplitude;
        // A press may have begun before the first group; that of an untouched sensor is.
        bool known = true;

        both_ends ratio() const { return amplitude.at(phase()); }
    } line;

    //! The tag or an antenna turns, or a hand comes near, which changes amplitudes too.
    struct tag_turn {
        bool goes_on = false, by_hand = false;
        // In this group; by a cable, each end by itself.
        bool sudden = false, parted = false;
        double velocity = 0;   // rad/s
        double age_s = 0;      // since it began
        std::size_t speed = 0; // how fast its velocity changes, of `turn_speeds`
        // Turns seen where nothing looks alike, in this time, hands, and cables that
        // moved.
        double seen = 0, hands = 0, moved = 0, watched_s = 0;
        double failed = 0, bursts = 0; // of the tag's supply, and what has hidden it

        //! How fast it turns now, rad/s.
        double rate() const { return goes_on ? velocity : 0; }
        //! Of the velocity of one that begins, or goes on beside something new, rad/s.
        double deviation() const;
        void begin(std::size_t at_speed, bool near)
        {
            goes_on = true;
            by_hand = near;
            speed = at_speed;
            velocity = age_s = 0;
        }
    } turn;

    //! Both phases and amplitudes of the press, or of the line while the tag turns it.
    struct held_or_moving {
        phase_motion motion;  // as it changes steadily,
        drifting_phases held; // or drifts like the untouched line
        bool steady = false, slides = false;
        std::size_t speed = 0; // of the steady change, of `speeds`
        // Of the image where it was in the group before (look_up).
        press_image::heading heading;
        double log_density = 0;
        both_amplitudes strength; // beside what the off states cause
        double with_common =
            0; // covariance of its difference with the line's common phase
    } press;

    //! Groups in which something changes: from where, and what is seen of the newest.
    struct mixture_of_states {
        press_state before = untouched;
        double age_s = 0; // of the state before
        both_ends start{}, seen{};
        double seen_variance = 0;
        double log_density = 0; // over that of any mixture
        bool single = true;     // one group so far
    } mixture;

    double log_fails = 0, log_works = 0; // that the supply fails in this group, or not
    double in_part = 0;   // probability that a part of this group was received only
    bool claimed = false; // nothing has changed since the user said that it is untouched
    average_of_groups mean;
    press_outcome now, last;

    //! What it is, or was before something changed.
    press_state before_change() const { return is == mixed ? mixture.before : is; }
    bool touched() const { return before_change() != untouched; }
    pair_of_ends change(const pair_of_ends& phase) const; // against the untouched line
    //! Counted from where everything has turned and grown by this.
    void recount(const pair_of_ends& phase, const pair_of_ends& gain);
    //! Become one with another of the same kind, which has a share of both weights.
    void merge(const explanation& other, double share);
    //! Press from where it is now.
    void hold_level()
    {
        press.held.reset(press.motion.phase(), press.motion.covariance());
    }
};

} // namespace gr::wiforce::kernel
