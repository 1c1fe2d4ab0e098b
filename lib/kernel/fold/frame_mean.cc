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
    for (std::uint64_t at = std::max(position, d_begin); at < end;) {
        const std::uint64_t place = (at - d_begin) % d_length;
        const std::uint64_t run = std::min(d_length - place, end - at);
        const Sample* const in = samples + (at - position);
        for (std::uint64_t n = 0; n < run; n++)
            d_sum[place + n] += std::complex<double>(in[n].real(), in[n].imag());
        at += run;
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
