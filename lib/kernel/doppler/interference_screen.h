// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "fourier_transform.h"
#include "phase_group.h"

#include <array>
#include <deque>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * Finds the snapshots of a phase group that other transmitters interfered with, by the
 * noise of each snapshot (snapshot_noise).
 *
 * A burst over the whole frame raises the smallest difference of the repetitions above
 * that of other snapshots. A burst over a part of it raises the largest one, which an
 * edge of a tag does as well. Such a snapshot is rejected beside one that is hit as a
 * whole, and where the difference exceeds what the tags can explain: the differences
 * between snapshots, in most of which the tags are in different states. Where many tags
 * switch, their edges sometimes raise all differences of a snapshot: as many snapshots as
 * they explain by chance are rejected only beyond what the tags can explain.
 *
 * A transmitter on a few subcarriers hits all samples as well. Where it costs less
 * information to lose these subcarriers than to lose the snapshots, they are kept: the
 * receiver weights each subcarrier of a group by its own noise (estimation/noise.py).
 *
 * What counts as noise is learned from the lower quantiles of some thousand snapshots, so
 * that it is valid with up to about 70 % of them hit. Everything is decided at the end of
 * a group: how the samples arrive does not change the result.
 */
class interference_screen
{
public:
    explicit interference_screen(int group_length);

    // Marks the snapshots of the next group that are to be rejected, 1 each; valid until
    // the next call.
    const std::vector<std::uint8_t>& examine(const phase_group& group);
    // Number of marks.
    int rejected() const { return d_rejected; }

private:
    using spectrum = std::array<float, FFT_LENGTH>;
    struct change { // of a snapshot against its neighbours, over the subcarriers
        float median;
        float mean;
    };

    void learn(const phase_group& group);
    bool mark_whole(const phase_group& group);
    bool mark_beyond_tags(const phase_group& group);
    void mark_neighbours(const phase_group& group);
    template <class Condition>
    int count_if(const phase_group& group, const Condition& condition) const;
    double edges_in_all_differences(const phase_group& group) const;
    float tag_level(const phase_group& group);
    void mark(int n);
    void keep_narrow_band(const phase_group& group);
    float measure_changes(const phase_group& group);
    change measure_change(const phase_group& group, int n);

    const int d_length;
    const std::size_t d_window; // groups
    // Highest noise without interference, by the groups of the window, and for this
    // group.
    std::deque<float> d_smallest_limits, d_largest_limits;
    float d_smallest_limit = 0;
    float d_largest_limit = 0;
    // Share of the snapshots in which a tag changes state, in the same way.
    std::deque<float> d_edge_shares;
    float d_edge_share = 0;
    std::vector<std::uint8_t> d_marks;
    int d_rejected = 0;
    // Of narrow-band interference: usual median over the subcarriers, by the groups of
    // the window that were hit; spectrum of each snapshot of the group, and its change.
    std::deque<float> d_medians;
    float d_usual_median = 0;
    fourier_transform d_fourier{ FFT_LENGTH };
    std::vector<fc32> d_spectra;
    std::vector<change> d_changes;
    spectrum d_powers;           // of the change of one snapshot
    std::vector<float> d_values; // scratch
    std::vector<int> d_slots;    // scratch
};

} // namespace gr::wiforce::kernel
