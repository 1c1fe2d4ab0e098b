// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/phase_group.h"
#include "../fourier/fourier_transform.h"
#include "order_statistics.h"

#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * Decides which snapshots with interference are kept, since it covers a few subcarriers
 * only.
 *
 * A transmitter on a few subcarriers hits all samples, and its snapshots are marked as
 * those of any other burst are. Where it costs less information to lose these subcarriers
 * than to lose the snapshots, they are kept: the receiver weights each subcarrier of a
 * group by its own noise (separation/noise_estimate.h).
 *
 * A snapshot is compared with its neighbours, subcarrier by subcarrier. Interference on a
 * few of them raises the mean of the change and not its median. Only marked snapshots are
 * compared, and a few others, from which the noise of a group is learned.
 */
class narrow_band_screen
{
public:
    explicit narrow_band_screen(int group_length,
                                int symbol_length = DEFAULT_SYMBOL_LENGTH);

    // Clears the marks of the snapshots that are kept; returns their number. To be called
    // for groups with marks.
    int keep(const phase_group& group, std::vector<std::uint8_t>& marks);

private:
    // From a snapshot to the next one; over the subcarriers.
    struct change {
        std::vector<float> powers; // empty where it was not measured
        float mean;
        float median; // below 0 where it was not needed
    };

    void learn_quiet(const phase_group& group, const std::vector<std::uint8_t>& marks);
    bool is_narrow(const phase_group& group, int n, float limit);
    const change* measured_change(const phase_group& group, int n);
    change* measured_pair(const phase_group& group, int n);

    const int d_length;
    const int d_width;             // subcarriers
    recent_level d_typical_median; // over the subcarriers
    fourier_transform d_fourier;
    std::vector<change> d_pairs;
    std::vector<const change*> d_quiet; // of snapshots without interference
    std::vector<std::uint8_t> d_is_narrow;
    std::vector<float> d_values, d_sorted; // scratch
    std::vector<int> d_slots;              // scratch
};

} // namespace gr::wiforce::kernel
