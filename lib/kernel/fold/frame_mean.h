// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <atomic>
#include <complex>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

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
        if (position < d_end && !d_interrupted)
            add(samples, count, position);
    }

    // Samples are lost here: frames behind them may come at another place.
    void interrupt() { d_interrupted = true; }

    // Empty while frames are missing, and for ever where samples were lost among them.
    std::vector<std::complex<double>> mean() const;

private:
    template <class Sample>
    void add(const Sample* samples, std::uint64_t count, std::uint64_t position);

    const std::uint64_t d_length, d_begin, d_end;
    std::vector<std::complex<double>> d_sum;
    bool d_interrupted = false;
    std::atomic<bool> d_complete{ false };
};

} // namespace gr::wiforce::kernel
