// SPDX-License-Identifier: GPL-3.0-or-later
#include "recorded_frames.h"

#include <algorithm>

namespace gr::wiforce::kernel {

namespace {

// Frames that are folded, and looked through for limited samples, at a time.
constexpr std::uint64_t BYTES_AT_ONCE = 1 << 19;

} // namespace

recorded_frames::recorded_frames(const std::string& path,
                                 const std::string& datatype,
                                 const std::vector<recording::segment>& segments,
                                 const preamble_folder& folder,
                                 std::uint64_t frame_offset,
                                 std::uint64_t header_bytes,
                                 std::function<void(std::uint64_t)> on_slip)
    : d_folder(folder),
      d_recording(path, datatype, segments, header_bytes),
      d_walk(folder, frame_offset),
      d_watched(d_recording.part()),
      d_on_slip(std::move(on_slip))
{
}

std::uint64_t recorded_frames::ready()
{
    while (true) {
        pass(std::min({ d_recording.ahead(), d_walk.until_decision(), d_walk.lead() }));
        const std::uint64_t whole =
            d_walk.whole_frames(std::min(d_recording.ahead(), d_walk.until_decision()));
        if (whole > 0)
            return whole;
        if (d_walk.decision_is_due())
            follow_frames();
        else if (!start_segment())
            return 0;
    }
}

frame_run recorded_frames::take(std::uint64_t count)
{
    const frame_run run = { d_recording.sample() + d_walk.lead(), frame(), count };
    pass(d_walk.span(count));
    return run;
}

void recorded_frames::pass(std::uint64_t samples)
{
    const std::uint64_t unwatched = std::min(samples, d_walk.until_watched());
    d_walk.pass_unwatched(unwatched);
    d_recording.pass(unwatched);
    const std::uint64_t watched = samples - unwatched;
    if (watched == 0)
        return;
    const std::uint64_t held =
        d_recording.look(*d_watched, d_recording.sample(), watched, [&](const auto* in) {
            d_walk.pass(in, watched);
        });
    if (held < watched)
        d_walk.skip(0); // forgets the zeros
    d_recording.pass(watched);
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
    d_walk.skip(d_recording.ahead());
    const auto start = d_recording.next_segment();
    if (!start)
        return false;
    // A segment's index counts the samples lost before it, those of a slip included.
    d_walk.skip(std::max(*start, d_walk.position()) - d_walk.position());
    return true;
}

std::uint64_t recorded_frames::read_at_once() const
{
    return BYTES_AT_ONCE / d_recording.sample_bytes();
}

frame_reader::frame_reader(recorded_frames& frames)
    : d_frames(frames),
      d_part(frames.d_recording.part()),
      d_at_once(std::max<std::uint64_t>(
          frames.read_at_once() / frames.d_folder.frame_length(), 1))
{
}

std::uint64_t frame_reader::fold(std::uint64_t most, fc32* folded, snapshot_noise* noise)
{
    std::uint64_t count = std::min({ most, d_run.count, d_at_once });
    while (count > 0) {
        const std::uint64_t wanted = d_frames.span(count);
        const std::uint64_t held = d_frames.d_recording.look(
            *d_part, d_run.sample, wanted, [&](const auto* samples) {
                d_frames.d_folder.fold(samples, count, folded, noise, d_saturated);
            });
        if (held == wanted)
            break;
        // The file was cut short: those that are whole are folded again, by themselves.
        while (count > 0 && d_frames.span(count) > held)
            count--;
        d_run.count = count;
    }
    if (count == 0)
        d_saturated.clear(); // of frames that were cut off while they were folded
    d_run.sample += count * d_frames.d_folder.frame_length();
    d_run.frame += count;
    d_run.count -= count;
    d_frames.d_folded += count;
    return count;
}

} // namespace gr::wiforce::kernel
