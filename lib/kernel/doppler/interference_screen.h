// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/phase_group.h"
#include "narrow_band_screen.h"
#include "order_statistics.h"

#include <limits>
#include <vector>

namespace gr::wiforce::kernel {

// Quantiles of the noise of a group's snapshots.
struct noise_statistics {
    float floor, level;
    float spread; // of the amplitude around the level, over that of the level
};

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
 * A transmitter on a few subcarriers hits all samples as well; such snapshots may be kept
 * (narrow_band_screen).
 *
 * What counts as noise is learned from the lower quantiles of some thousand snapshots, so
 * that it is valid with up to about 70 % of them hit. Everything is decided at the end of
 * a group: how the samples arrive does not change the result.
 */
class interference_screen
{
public:
    explicit interference_screen(int group_length,
                                 int symbol_length = DEFAULT_SYMBOL_LENGTH);

    // Marks the snapshots of the next group that are to be rejected, 1 each; valid until
    // the next call.
    const std::vector<std::uint8_t>& examine(const phase_group& group);
    const std::vector<std::uint8_t>& marks() const { return d_marks; }
    // Number of marks.
    int rejected() const { return d_rejected; }

private:
    void learn(const phase_group& group);
    noise_statistics statistics_of(const phase_group& group,
                                   float snapshot_noise::*member,
                                   std::size_t known,
                                   float& high);
    bool mark_whole(const phase_group& group);
    bool mark_beyond_tags(const phase_group& group);
    void mark_neighbours(const phase_group& group);
    template <class Condition>
    int count_if(const phase_group& group, const Condition& condition) const;
    double edges_in_all_differences(const phase_group& group) const;
    float tag_level(const phase_group& group,
                    float noise = std::numeric_limits<float>::infinity());
    void mark(int n);

    const int d_length;
    // Highest noise without interference.
    recent_level d_smallest_limit, d_largest_limit;
    recent_level d_edge_share; // of the snapshots in which a tag changes state
    std::vector<std::uint8_t> d_marks;
    int d_rejected = 0;
    narrow_band_screen d_narrow_band;
    snapshot_noise d_high = {};  // upper quantiles of the latest group
    std::vector<float> d_values; // scratch
    std::vector<int> d_slots;    // scratch
};

} // namespace gr::wiforce::kernel
