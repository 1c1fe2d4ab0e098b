// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fourier/fourier_transform.h"
#include "../types.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

// Adds samples that follow each other from `position` on to sums over frames, of which
// the first begins at `begin`; those before it, and from `end` on, are ignored.
template <class Sample, class Sum>
void add_frames(const Sample* samples,
                std::uint64_t count,
                std::uint64_t position,
                std::uint64_t begin,
                std::uint64_t end,
                std::vector<Sum>& sums)
{
    const std::uint64_t length = sums.size();
    end = std::min(end, position + count);
    for (std::uint64_t at = std::max(position, begin); at < end;) {
        const std::uint64_t place = (at - begin) % length;
        const std::uint64_t run = std::min(length - place, end - at);
        const Sample* const in = samples + (at - position);
        for (std::uint64_t n = 0; n < run; n++)
            sums[place + n] += Sum(in[n].real(), in[n].imag());
        at += run;
    }
}

/*
 * Monitors that the frames of a stream stay on their grid.
 *
 * Now and then some whole frames, guard included, are averaged and compared with the
 * average before: static paths must arrive at the same sample. When they do not, the
 * average before is searched for at every cyclic shift, by FFTs of the frame's length,
 * whose plan is made with the watch. A shift counts when two averages in a row agree on
 * it and contain nearly all of the energy.
 */
class frame_watch
{
public:
    static constexpr std::uint64_t AVERAGED = 16; // frames that are compared at a time
    static constexpr std::uint64_t PERIOD = 1024; // frames from one average to the next
    static constexpr int LONGEST_SEARCH = 3;      // averages in a row
    // Frames before decide() finds a shift, at most, that are shifted already.
    static constexpr std::uint64_t UNNOTICED = PERIOD + LONGEST_SEARCH * AVERAGED;

    // The grid begins at position `origin`; frame_length >= 1.
    frame_watch(int frame_length, std::uint64_t origin);

    // Position at which decide() is to be called: the first sample of a frame.
    std::uint64_t decision() const { return d_begin + averaged_samples(); }
    // Samples before it that are averaged; the others are ignored.
    std::uint64_t averaged_samples() const { return AVERAGED * d_length; }
    // Samples from `position` to the first of them.
    std::uint64_t until_averaged(std::uint64_t position) const
    {
        return std::max(d_begin, position) - position;
    }

    // Takes the samples that follow each other from `position` on, none beyond
    // decision().
    template <class Sample>
    void take(const Sample* samples, std::uint64_t count, std::uint64_t position)
    {
        add_frames(samples, count, position, d_begin, decision(), d_sum);
    }

    // Samples by which the frames come later than the grid says, 0 <= shift <
    // frame_length.
    int decide();

    // Starts anew behind samples that were lost or not given.
    void restart(std::uint64_t position);

private:
    using profile = std::vector<fc32>;

    profile average() const;
    int find_shift(const profile& now);
    int judge(const profile& now);

    const std::uint64_t d_length;
    const std::uint64_t d_origin;
    std::uint64_t d_begin; // of the frames that are averaged
    profile d_sum;
    int d_searching = 0; // averages in a row that do not match
    profile d_reference; // empty at first
    profile d_candidate; // the next reference, unless frames moved while it was averaged
    profile d_mismatch;  // the last average that did not match; empty when one did
    fourier_transform d_fourier;
};

} // namespace gr::wiforce::kernel
