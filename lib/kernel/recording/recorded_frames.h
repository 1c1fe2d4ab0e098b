// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/frame_walk.h"
#include "recording.h"

#include <functional>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The whole frames of a recording, folded, in order.
 *
 * Frames lie on a grid that starts frame_offset samples after the first segment's first
 * one. Where they come elsewhere, they are followed (see frame_walk).
 */
class recorded_frames
{
public:
    // `on_slip` is called with the samples by which frame timing slipped. Throws as
    // `recording` does.
    recorded_frames(const std::string& path,
                    const std::string& datatype,
                    const std::vector<recording::segment>& segments,
                    const preamble_folder& folder,
                    std::uint64_t frame_offset,
                    std::uint64_t header_bytes,
                    std::function<void(std::uint64_t)> on_slip = {});

    // Whole frames in memory that follow each other, from frame() on; 0 at the end. Reads
    // on when there are none.
    std::uint64_t ready();
    // Index on the grid of the next frame.
    std::uint64_t frame() const { return d_walk.frame(); }
    // Folds the next frames, at most as many as are ready.
    void fold(int frames, fc32* folded, snapshot_noise* noise);
    // Of the frames last folded, those that hold samples at full scale.
    const std::vector<int>& saturated() const { return d_saturated; }

    int symbol_length() const { return d_folder.symbol_length(); }

    std::uint64_t folded() const { return d_folded; } // frames
    std::uint64_t frames_moved() const { return d_frames_moved; }
    // Frames before each slip that may lie elsewhere.
    const std::vector<frame_range>& misplaced() const { return d_misplaced; }
    std::uint64_t samples_missing() const { return d_recording.samples_missing(); }

private:
    void pass_lead(std::uint64_t available);
    void follow_frames();
    bool start_segment();

    const preamble_folder d_folder;
    recording d_recording;
    frame_walk d_walk;
    const std::function<void(std::uint64_t)> d_on_slip;
    std::vector<int> d_saturated;
    counter d_folded;
    counter d_frames_moved;
    std::vector<frame_range> d_misplaced;
};

} // namespace gr::wiforce::kernel
