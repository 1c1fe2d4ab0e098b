// SPDX-License-Identifier: GPL-3.0-or-later
#include "folded_reader.h"

#include <algorithm>

namespace gr::wiforce::kernel {

folded_reader::folded_reader(std::unique_ptr<recorded_frames> frames)
    : d_frames(std::move(frames))
{
}

folded_reader::batch folded_reader::read(std::size_t max_frames)
{
    const std::lock_guard<std::mutex> one_at_a_time(d_mutex);
    batch frames;
    const std::size_t length = d_frames->symbol_length();
    while (frames.snapshot.size() < max_frames) {
        const std::size_t before = frames.snapshot.size();
        const std::size_t count =
            std::min<std::uint64_t>(d_frames->ready(), max_frames - before);
        if (count == 0)
            break;
        for (std::size_t n = 0; n < count; n++)
            frames.snapshot.push_back(d_frames->frame() + n);
        frames.folded.resize((before + count) * length);
        frames.noise.resize(before + count);
        d_frames->fold(count, &frames.folded[before * length], &frames.noise[before]);
        frames.saturated.resize(before + count);
        for (const int frame : d_frames->saturated())
            frames.saturated[before + frame] = 1;
    }
    return frames;
}

} // namespace gr::wiforce::kernel
