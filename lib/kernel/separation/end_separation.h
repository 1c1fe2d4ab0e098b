// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "clock_tracker.h"
#include "end_fit.h"
#include "group_weights.h"
#include "noise_estimate.h"
#include "spread_lines.h"

#include <cstddef>
#include <deque>
#include <functional>
#include <utility>
#include <variant>
#include <vector>

namespace gr::wiforce::kernel {

// Median of the last values that are finite, and their number.
class running_median
{
public:
    std::pair<double, std::size_t> update(double value);

private:
    std::deque<double> d_latest;
    std::vector<double> d_sorted;
};

// Separates the tones of groups into the channels of the tags' ends, one group after the
// other: the clocks are corrected, the tones are solved for the ends at these, and noise
// and standard deviations follow from the residual (docs/theory.md, Ends).
class end_separation
{
public:
    struct settings {
        std::size_t tags;         // S, of which some may not be locked
        std::size_t group_length; // snapshots of a complete group
        double averaging_s;       // that a snapshot is a mean over
        bool jointly;             // clocks by the complete model, not by each tag's lines
        // Power of line 1 of end 1, by which the SNR is defined.
        double line_power;
        // Error of a phase, in rad, that noise does not explain; 0 unless symbols are
        // long.
        double least_error;
        double absent_s, unseen_s; // see clock_tracker::expired
    };

    // A tag whose clock is tracked.
    struct tag {
        std::size_t index; // among all
        clock_tracker* clock;
        const clock_likelihood* likelihood;
        std::vector<std::size_t> lines;   // tones that the likelihood is of
        double nominal_rate, stated_rate; // rad/s
        switching_pulses pulses;
        bool overlapping; // its two switches are on together
    };

    struct group {
        const group_weights* weights;
        double center_s;
        bool complete; // the noise may be learned from it
        std::variant<const fc32*, const complex*> tones; // M x K
    };

    // Removes from the residual of a fit what the wander of clocks within the group
    // explains, by its number and the tags' clocks (phases in rad, rates in rad/s above
    // nominal).
    using remove_wander = std::function<void(std::size_t number,
                                             end_fit& fit,
                                             const std::vector<double>& phase,
                                             const std::vector<double>& rate)>;

    // Of the first groups given, up to one that the noise does not fit, or before which
    // the clock of a tag is given up. By end: 2S; by tag: S; by subcarrier: K. Ends of
    // tags that are not locked are 0, and their gain is infinite.
    struct separated {
        std::size_t groups = 0;
        noise_estimate::verdict outcome = noise_estimate::verdict::learned;
        std::vector<complex> ends;             // 2S x K
        std::vector<double> gain, snr_db;      // 2S
        std::vector<double> noise, noise_rise; // K
        std::vector<double>
            raised; // by group: share of the information that raised noise costs
        std::vector<char> locked, overlapping, disturbed;                // S
        std::vector<double> clock_phase, clock_offset_ppm, clock2_delay; // S
    };

    explicit end_separation(settings of) : d_settings(of), d_coherent(2 * of.tags) {}

    std::size_t tags() const { return d_settings.tags; }

    // Forgets the residuals so far, when the clocks were acquired again.
    void reset() { d_coherent.assign(d_coherent.size(), {}); }

    // `update`: clocks and noise, unless they were acquired from these very groups.
    // `spread`: may be null, `wander`: empty, where there is nothing to remove.
    separated process(const std::vector<tag>& tags,
                      const std::vector<group>& groups,
                      std::size_t subcarriers,
                      noise_estimate& noise,
                      bool update,
                      spread_lines* spread,
                      const remove_wander& wander);

private:
    struct one; // group that is being separated

    void find_tags(one& in, bool correct) const; // `correct`: clocks as well
    void separate(one& of, bool update);

    const settings d_settings;
    std::vector<running_median> d_coherent; // ratios of the residual, by end
};

} // namespace gr::wiforce::kernel
