// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../doppler/phase_group.h"
#include "../fourier/fourier_transform.h"
#include "recent_level.h"

#include <vector>

namespace gr::wiforce::kernel {

/*
 * Decides which snapshots with interference are kept, since it covers a few subcarriers
 * only.
 *
 * A transmitter on a few subcarriers hits all samples, and its snapshots are marked as
 * those of any other burst are. Where it costs less information to lose these subcarriers
 * than to lose the snapshots, they are kept: the receiver weights each subcarrier of a
 * group by its own noise (estimation/ends/noise.py).
 *
 * A snapshot is compared with its neighbours, subcarrier by subcarrier. Interference on a
 * few of them raises the mean of the change and not its median.
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
    using spectrum = std::vector<float>;
    // From a snapshot, the pair's first one, to the next; over the subcarriers.
    struct change {
        float median = 0;
        float mean = 0;
        int pair = -1; // none
    };

    float measure_changes(const phase_group& group,
                          const std::vector<std::uint8_t>& marks);
    change measure_pair(int n);
    change change_of(int n) const;

    const int d_length;
    const int d_width;             // subcarriers
    recent_level d_typical_median; // over the subcarriers
    fourier_transform d_fourier;
    std::vector<fc32> d_spectra;
    std::vector<change> d_pairs;
    std::vector<change> d_changes; // of each snapshot
    spectrum d_powers;             // of a pair
    std::vector<float> d_values;   // scratch
    spectrum d_sorted;             // scratch
    std::vector<int> d_narrow;     // snapshots with interference on a few subcarriers
};

} // namespace gr::wiforce::kernel
