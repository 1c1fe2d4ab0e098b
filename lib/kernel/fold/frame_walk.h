// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../timing/frame_watch.h"
#include "preamble_folder.h"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

// A frame and the one behind the last.
using frame_range = std::pair<std::uint64_t, std::uint64_t>;

/*
 * Walks over the frames of a stream of samples: which are whole, where the next one lies,
 * and whether they still come at their place on the grid.
 *
 * A position counts the samples of the stream, lost ones included. The averaged samples
 * of frame n begin at position frame_offset + first_averaged + n frame_length, and the
 * frame is whole when none of them is missing. The position is all that is kept: a frame
 * whose averaged samples began before it is either done or cut.
 *
 * The caller owns the samples. It passes those that follow each other without a gap, none
 * beyond until_decision(), and skips those that were lost or are not to be used.
 */
class frame_walk
{
public:
    frame_walk(const preamble_folder& folder, std::uint64_t frame_offset);

    // Of the next sample.
    std::uint64_t position() const { return d_position; }
    // Index of the next frame whose averaged samples all lie ahead.
    std::uint64_t frame() const;
    // Samples before the first of them.
    std::uint64_t lead() const;
    // Frames from frame() on that are whole when `available` samples follow.
    std::uint64_t whole_frames(std::uint64_t available) const;
    // Samples from the next one to the last averaged one of so many frames.
    std::uint64_t span(std::uint64_t frames) const;

    // Samples that may be passed until decide() is due.
    std::uint64_t until_decision() const { return d_watch.decision() - d_position; }
    bool decision_is_due() const { return until_decision() == 0; }
    // Of these, samples before those that are watched: they need not be read.
    std::uint64_t until_watched() const { return d_watch.until_averaged(d_position); }
    void pass_unwatched(std::uint64_t count) { d_position += count; }

    template <class Sample>
    void pass(const Sample* samples, std::uint64_t count)
    {
        d_watch.take(samples, count, d_position);
        d_position += count;
    }

    void skip(std::uint64_t samples);

    // Compares the frames passed lately with those before. When they come elsewhere,
    // samples were lost or repeated that nobody reported: their number, known modulo the
    // frame length, is skipped and returned. 0 when the frames stayed in place.
    std::uint64_t decide();
    // First frame before the last slip, and the one behind the last, that may lie
    // elsewhere.
    const frame_range& misplaced() const { return d_misplaced; }

private:
    const std::uint64_t d_frame_length;
    const std::uint64_t d_averaged_length;
    const std::uint64_t d_first_averaged; // position in the stream, of frame 0
    std::uint64_t d_position = 0;
    frame_watch d_watch;
    frame_range d_misplaced;
};

/*
 * Mean of the first frames of a stream as a whole, guard included, in units of the
 * samples. It shows what is the same in all frames: static paths, the receiver's offset
 * and its compression (estimation/capture/compression.py).
 *
 * One thread takes samples, others may ask for the mean.
 */
class frame_mean
{
public:
    static constexpr std::uint64_t FRAMES = 1000; // noise is reduced by 30 dB

    frame_mean(int frame_length, std::uint64_t frame_offset);

    // Takes the samples that follow each other from `position` on; those of later frames
    // are ignored.
    template <class Sample>
    void take(const Sample* samples, std::uint64_t count, std::uint64_t position)
    {
        if (position >= d_end || d_interrupted)
            return;
        add_frames(samples, count, position, d_begin, d_end, d_sum);
        if (position + count >= d_end)
            d_complete.store(true, std::memory_order_release);
    }

    // Samples are lost here: frames behind them may come at another place.
    void interrupt() { d_interrupted = true; }

    // Empty while frames are missing, and for ever where samples were lost among them.
    std::vector<complex> mean() const;

private:
    const std::uint64_t d_begin, d_end;
    std::vector<complex> d_sum;
    bool d_interrupted = false;
    std::atomic<bool> d_complete{ false };
};

} // namespace gr::wiforce::kernel
