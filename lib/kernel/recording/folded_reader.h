// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "recorded_frames.h"

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
    std::mutex d_mutex;
};

} // namespace gr::wiforce::kernel
