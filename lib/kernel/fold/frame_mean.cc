// SPDX-License-Identifier: GPL-3.0-or-later
#include "frame_mean.h"

#include <algorithm>

namespace gr::wiforce::kernel {

frame_mean::frame_mean(int frame_length, std::uint64_t frame_offset)
    : d_length(frame_length),
      d_begin(frame_offset),
      d_end(frame_offset + FRAMES * frame_length),
      d_sum(frame_length)
{
}

template <class Sample>
void frame_mean::add(const Sample* samples, std::uint64_t count, std::uint64_t position)
{
    const std::uint64_t end = std::min(position + count, d_end);
    for (std::uint64_t at = std::max(position, d_begin); at < end; at++) {
        const Sample& sample = samples[at - position];
        d_sum[(at - d_begin) % d_length] +=
            std::complex<double>(sample.real(), sample.imag());
    }
    if (end == d_end)
        d_complete.store(true, std::memory_order_release);
}

template void frame_mean::add(const fc32*, std::uint64_t, std::uint64_t);
template void frame_mean::add(const sc16*, std::uint64_t, std::uint64_t);

std::vector<std::complex<double>> frame_mean::mean() const
{
    if (!d_complete.load(std::memory_order_acquire))
        return {};
    auto mean = d_sum;
    for (auto& value : mean)
        value /= double(FRAMES);
    return mean;
}

} // namespace gr::wiforce::kernel
