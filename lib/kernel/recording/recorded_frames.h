// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/frame_walk.h"
#include "recording.h"

#include <functional>
#include <memory>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

// Frames that follow each other in a file.
struct frame_run {
    std::uint64_t sample; // first averaged one of the first frame, in the file
    std::uint64_t frame;  // its index on the grid
    std::uint64_t count;
};

/*
 * The whole frames of a recording, in order.
 *
 * Frames lie on a grid that starts frame_offset samples after the first segment's first
 * one. Where they come elsewhere, they are followed (see frame_walk). Of the samples,
 * only those that are watched for this are read here. One thread at a time takes runs of
 * frames, which others read and fold meanwhile (frame_reader).
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

    // Whole frames that follow each other in the file, from frame() on; 0 at the end.
    std::uint64_t ready();
    // Index on the grid of the next frame.
    std::uint64_t frame() const { return d_walk.frame(); }
    // Passes the next frames, at most as many as are ready.
    frame_run take(std::uint64_t count);

    int symbol_length() const { return d_folder.symbol_length(); }
    // Samples of the first `count` averaged frames of a run.
    std::uint64_t span(std::uint64_t count) const
    {
        return (count - 1) * d_folder.frame_length() + d_folder.averaged_length();
    }

    // Samples that are folded at a time.
    std::uint64_t read_at_once() const;

    std::uint64_t folded() const { return d_folded; } // frames
    std::uint64_t frames_moved() const { return d_frames_moved; }
    // Frames before each slip that may lie elsewhere.
    const std::vector<frame_range>& misplaced() const { return d_misplaced; }
    std::uint64_t samples_missing() const { return d_recording.samples_missing(); }

private:
    friend class frame_reader;

    void pass(std::uint64_t samples);
    void follow_frames();
    bool start_segment();

    const preamble_folder d_folder;
    recording d_recording;
    frame_walk d_walk;
    const std::unique_ptr<mapped_part> d_watched;
    const std::function<void(std::uint64_t)> d_on_slip;
    counter d_folded;
    counter d_frames_moved;
    std::vector<frame_range> d_misplaced;
};

// Folds runs of frames where the file lies in memory.
class frame_reader
{
public:
    explicit frame_reader(recorded_frames& frames);

    void begin(const frame_run& run) { d_run = run; }
    // The frames of the run that are not folded yet.
    const frame_run& rest() const { return d_run; }
    // Folds the next ones; returns how many. 0 at the end of the run, which is where the
    // file was cut short if that comes first.
    std::uint64_t fold(std::uint64_t most, fc32* folded, snapshot_noise* noise);
    // Of the frames last folded, those that hold samples at full scale.
    const std::vector<int>& saturated() const { return d_saturated; }

private:
    recorded_frames& d_frames;
    const std::unique_ptr<mapped_part> d_part;
    const std::uint64_t d_at_once; // frames
    frame_run d_run = {};
    std::vector<int> d_saturated;
};

} // namespace gr::wiforce::kernel
