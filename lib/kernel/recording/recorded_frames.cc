// SPDX-License-Identifier: GPL-3.0-or-later
#include "recorded_frames.h"

#include <algorithm>

namespace gr::wiforce::kernel {

recorded_frames::recorded_frames(const std::string& path,
                                 const std::string& datatype,
                                 const std::vector<recording::segment>& segments,
                                 const preamble_folder& folder,
                                 std::uint64_t frame_offset,
                                 std::uint64_t header_bytes,
                                 std::function<void(std::uint64_t)> on_slip)
    : d_folder(folder),
      d_recording(path, datatype, segments, header_bytes, folder.averaged_length()),
      d_walk(folder, frame_offset),
      d_on_slip(std::move(on_slip))
{
}

std::uint64_t recorded_frames::ready()
{
    while (true) {
        pass_lead(std::min(d_recording.held(), d_walk.until_decision()));
        const std::uint64_t whole =
            d_walk.whole_frames(std::min(d_recording.held(), d_walk.until_decision()));
        if (whole > 0)
            return whole;
        if (d_walk.decision_is_due())
            follow_frames();
        else if (!d_recording.read_on() && !start_segment())
            return 0;
    }
}

void recorded_frames::pass_lead(std::uint64_t available)
{
    d_recording.visit([&](const auto* samples) {
        d_recording.drop(d_walk.pass_lead(samples, available));
    });
}

void recorded_frames::fold(int frames, fc32* folded, snapshot_noise* noise)
{
    d_recording.visit([&](const auto* samples) {
        const auto* averaged = samples + d_walk.lead();
        d_folder.fold(averaged, frames, folded, noise, &d_saturated);
        const std::uint64_t count = d_walk.span(frames);
        d_walk.pass(samples, count);
        d_recording.drop(count);
    });
    d_folded += frames;
}

void recorded_frames::follow_frames()
{
    const std::uint64_t lost = d_walk.decide();
    if (lost == 0)
        return;
    d_frames_moved += 1;
    d_misplaced.push_back(d_walk.misplaced());
    if (d_on_slip)
        d_on_slip(lost);
}

bool recorded_frames::start_segment()
{
    d_walk.skip(d_recording.held());
    const auto start = d_recording.next_segment();
    if (!start)
        return false;
    // A segment's index counts the samples lost before it, those of a slip included.
    d_walk.skip(std::max(*start, d_walk.position()) - d_walk.position());
    return true;
}

} // namespace gr::wiforce::kernel
