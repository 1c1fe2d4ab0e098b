// SPDX-License-Identifier: GPL-3.0-or-later
#include "recorded_frames.h"

#include <algorithm>

namespace gr::wiforce::kernel {

namespace {

// A read of half a megabyte costs little more than its copy, and leaves the samples in
// the second cache. Guards are read as well: leaving them out takes a call per frame,
// which doubles the time (frames of 720 samples, page cache).
constexpr std::uint64_t READ_BYTES = 1 << 19;

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
      d_watched(READ_BYTES),
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
    for (std::uint64_t left = samples - unwatched; left > 0;) {
        const std::uint64_t count = std::min(left, read_at_once());
        const std::uint64_t read =
            d_recording.read(d_recording.sample(), count, d_watched.data());
        d_recording.visit(d_watched.data(),
                          [&](const auto* in) { d_walk.pass(in, read); });
        if (read < count)
            d_walk.skip(count - read);
        d_recording.pass(count);
        left -= count;
    }
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
    return READ_BYTES / d_recording.sample_bytes();
}

frame_reader::frame_reader(recorded_frames& frames)
    : d_frames(frames),
      d_at_once(std::max<std::uint64_t>(
          frames.read_at_once() / frames.d_folder.frame_length(), 1))
{
}

void frame_reader::read_on()
{
    const std::uint64_t frames = std::min(d_run.count, d_at_once);
    const std::uint64_t wanted = d_frames.span(frames);
    d_buffer.resize(
        std::max(d_buffer.size(), wanted * d_frames.d_recording.sample_bytes()));
    const std::uint64_t read =
        d_frames.d_recording.read(d_run.sample, wanted, d_buffer.data());
    d_held = frames;
    while (d_held > 0 && d_frames.span(d_held) > read)
        d_held--;
    d_first = 0;
    if (d_held < frames)
        d_run.count = d_held;
}

std::uint64_t frame_reader::fold(std::uint64_t most, fc32* folded, snapshot_noise* noise)
{
    if (d_held == 0 && d_run.count > 0)
        read_on();
    const std::uint64_t count = std::min(most, d_held);
    const std::uint64_t stride = d_frames.d_folder.frame_length();
    d_frames.d_recording.visit(d_buffer.data(), [&](const auto* samples) {
        d_frames.d_folder.fold(
            samples + d_first * stride, count, folded, noise, &d_saturated);
    });
    d_first += count;
    d_held -= count;
    d_run.sample += count * stride;
    d_run.frame += count;
    d_run.count -= count;
    d_frames.d_folded += count;
    return count;
}

} // namespace gr::wiforce::kernel
