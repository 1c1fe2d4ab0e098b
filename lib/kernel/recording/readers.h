// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../doppler/group_collector.h"
#include "../fourier/channel_equalizer.h"
#include "recorded_frames.h"

#include <functional>
#include <memory>
#include <mutex>

namespace gr::wiforce::kernel {

// The whole frames of a recording, folded: what recording_source gives, without a
// flowgraph.
class folded_reader
{
public:
    struct batch {
        std::vector<std::int64_t> snapshot; // indices on the frame grid
        std::vector<fc32> folded;           // snapshots x symbol_length
        std::vector<snapshot_noise> noise;
        std::vector<std::uint8_t> saturated;
    };

    explicit folded_reader(std::unique_ptr<recorded_frames> frames);

    // The next frames, fewer than `max_frames` at the end only. Any thread may call it,
    // and ask the counters meanwhile.
    batch read(std::size_t max_frames);
    const recorded_frames& frames() const { return *d_frames; }

private:
    const std::unique_ptr<recorded_frames> d_frames;
    frame_reader d_reader;
    std::mutex d_mutex;
};

/*
 * The phase groups of a recording as the channel of each Doppler tone on the occupied
 * subcarriers: what recording_source, phase_group_doppler and ofdm_channel_estimator
 * give, without a flowgraph.
 *
 * Groups without any snapshot are left out, and so is the unfinished last one. Where the
 * thread that makes the reader may run on several processors, two groups are folded side
 * by side; this changes no value.
 */
class tone_reader
{
public:
    struct batch {
        std::vector<std::int64_t> index; // snapshot index / N_g
        std::vector<fc32> tones;         // groups x rows x bins
        std::vector<std::int64_t> missing;
        std::vector<std::int64_t> rejected;  // snapshots, for interference
        std::vector<std::int64_t> saturated; // snapshots
    };

    // `weights` holds rows x group_length values, `bins` the FFT bins to keep, in order.
    // Throws std::invalid_argument as tone_accumulator and channel_equalizer do, and when
    // a bin or the number of factors does not fit the frames' symbol.
    tone_reader(std::unique_ptr<recorded_frames> frames,
                const std::vector<std::complex<double>>& weights,
                int group_length,
                const std::vector<std::complex<double>>& factors,
                const std::vector<std::complex<double>>& rotation,
                const std::vector<int>& bins);

    ~tone_reader();

    int rows() const { return d_rows; }
    const std::vector<int>& bins() const { return d_bins; }

    // Takes an incomplete group and its row in the batch; called in order, by any thread.
    using incomplete_handler = std::function<void(std::size_t, const phase_group&)>;

    // The next groups, fewer than `max_groups` at the end only. Any thread may call it,
    // and ask the counters meanwhile. Incomplete groups are handed over while their
    // snapshots are in the cache: to keep those of a batch takes as long as their sums.
    batch read(std::size_t max_groups, const incomplete_handler& take_incomplete = {});
    const recorded_frames& frames() const { return *d_frames; }

private:
    struct worker;
    struct round;

    bool take_group(std::vector<frame_run>& runs);
    void work(worker&, round&, batch&, const incomplete_handler&);
    void fold(worker&);
    bool end_group(group_collector&, batch&, const incomplete_handler&);
    std::size_t values() const { return d_rows * d_bins.size(); } // of a group

    const std::unique_ptr<recorded_frames> d_frames;
    const int d_group_length;
    const std::vector<int> d_bins;
    int d_rows;
    std::vector<std::unique_ptr<worker>> d_workers;
    std::mutex d_mutex;
};

} // namespace gr::wiforce::kernel
