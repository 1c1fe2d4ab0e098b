// SPDX-License-Identifier: GPL-3.0-or-later
#include "frame_walk.h"

namespace gr::wiforce::kernel {

frame_walk::frame_walk(const preamble_folder& folder, std::uint64_t frame_offset)
    : d_frame_length(folder.frame_length()),
      d_averaged_length(folder.averaged_length()),
      d_first_averaged(frame_offset + folder.first_averaged()),
      d_watch(folder.frame_length(), frame_offset)
{
}

std::uint64_t frame_walk::frame() const
{
    if (d_position <= d_first_averaged)
        return 0;
    return (d_position - d_first_averaged + d_frame_length - 1) / d_frame_length;
}

std::uint64_t frame_walk::lead() const
{
    return d_first_averaged + frame() * d_frame_length - d_position;
}

std::uint64_t frame_walk::whole_frames(std::uint64_t available) const
{
    const std::uint64_t first = lead() + d_averaged_length;
    return available < first ? 0 : 1 + (available - first) / d_frame_length;
}

std::uint64_t frame_walk::span(std::uint64_t frames) const
{
    return lead() + (frames - 1) * d_frame_length + d_averaged_length;
}

void frame_walk::skip(std::uint64_t samples)
{
    d_position += samples;
    d_watch.restart(d_position);
}

std::uint64_t frame_walk::decide()
{
    const std::uint64_t shift = d_watch.decide();
    if (shift == 0)
        return 0;
    d_misplaced = { frame() - std::min(frame(), frame_watch::UNNOTICED), frame() };
    const std::uint64_t lost = d_frame_length - shift;
    skip(lost);
    return lost;
}

frame_mean::frame_mean(int frame_length, std::uint64_t frame_offset)
    : d_begin(frame_offset),
      d_end(frame_offset + FRAMES * frame_length),
      d_sum(frame_length)
{
}

std::vector<complex> frame_mean::mean() const
{
    if (!d_complete.load(std::memory_order_acquire))
        return {};
    auto mean = d_sum;
    for (auto& value : mean)
        value /= double(FRAMES);
    return mean;
}

} // namespace gr::wiforce::kernel
