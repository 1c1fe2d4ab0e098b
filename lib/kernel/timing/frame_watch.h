// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * Watches that the frames of a stream stay on their grid.
 *
 * Now and then some whole frames, guard included, are averaged and compared with the
 * average before: what stands still must come at the same sample. When it does not, the
 * average before is looked for at every cyclic shift. A shift counts when two averages in
 * a row agree on it and nearly all of the energy does.
 *
 * That search takes time by the square of the frame length, 2 ms for 720 samples and 0.2
 * s for LONGEST_FRAME: longer frames are not watched.
 */
class frame_watch
{
public:
    static constexpr int LONGEST_FRAME = 8192;

    // The grid begins at position `origin`. Throws std::invalid_argument unless
    // frame_length >= 1.
    frame_watch(int frame_length, std::uint64_t origin);

    // Position at which decide() is to be called; the first sample of a frame, or one
    // that never comes when frames are not watched.
    std::uint64_t decision() const
    {
        return d_watches ? d_begin + averaged_samples() : NEVER;
    }
    // Samples before it that are averaged; no others need to be given.
    std::uint64_t averaged_samples() const { return AVERAGED * d_length; }

    // Samples as they come, none beyond decision().
    template <class Sample>
    void take(const Sample* samples, std::uint64_t count, std::uint64_t position);

    // Samples by which the frames come later than the grid says, 0 <= shift <
    // frame_length.
    int decide();

    // Goes on at a position of the grid where the stream was interrupted.
    void restart(std::uint64_t position);

private:
    static constexpr std::uint64_t NEVER = ~std::uint64_t(0);
    static constexpr std::uint64_t AVERAGED = 16; // frames
    static constexpr std::uint64_t PERIOD = 1024; // of them
    static constexpr int MOST_DOUBTS = 3;         // averages in a row

    using profile = std::vector<fc32>;

    profile average() const;
    int find_shift(const profile& now) const;
    int judge(const profile& now);

    const std::uint64_t d_length;
    const bool d_watches;
    const std::uint64_t d_origin;
    std::uint64_t d_begin;    // of the frames that are averaged
    std::vector<float> d_sum; // real and imaginary parts of a frame
    int d_doubts = 0;
    profile d_usual;  // as it should be; empty at first
    profile d_next;   // to be so, unless frames moved while it was averaged
    profile d_latest; // the last one that was not so
};

} // namespace gr::wiforce::kernel
