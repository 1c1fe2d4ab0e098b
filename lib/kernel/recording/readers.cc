// SPDX-License-Identifier: GPL-3.0-or-later
#include "readers.h"

#include "../doppler/tone_accumulator.h"
#include "../require.h"

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

tone_reader::tone_reader(std::unique_ptr<recorded_frames> frames,
                         const std::vector<std::complex<double>>& weights,
                         int group_length,
                         const std::vector<std::complex<double>>& factors,
                         const std::vector<std::complex<double>>& rotation,
                         const std::vector<int>& bins)
    : d_frames(std::move(frames)),
      d_collector(std::make_unique<tone_accumulator>(
                      weights, group_length, d_frames->symbol_length()),
                  group_length,
                  d_frames->symbol_length()),
      d_channel(factors, d_collector.rows(), rotation, bins),
      d_transform(d_collector.size())
{
    require(d_channel.symbol_length() == d_frames->symbol_length(),
            "tone_reader",
            "factors",
            "must be as many as a symbol has samples, " +
                std::to_string(d_frames->symbol_length()),
            d_channel.symbol_length());
}

tone_reader::batch tone_reader::read(std::size_t max_groups,
                                     const incomplete_handler& take_incomplete)
{
    const std::lock_guard<std::mutex> one_at_a_time(d_mutex);
    batch groups;
    while (groups.index.size() < max_groups) {
        const std::uint64_t ready = d_frames->ready();
        if (ready == 0)
            break;
        if (d_collector.must_end_before(d_frames->frame())) {
            end_group(groups, take_incomplete);
            continue;
        }
        d_collector.add(d_frames->frame(),
                        std::min<std::uint64_t>(ready, d_collector.BATCH),
                        [&](int count, fc32* folded, snapshot_noise* noise) {
                            d_frames->fold(count, folded, noise);
                        });
        d_collector.note_saturated(d_frames->saturated().size());
        if (d_collector.is_full())
            end_group(groups, take_incomplete);
    }
    return groups;
}

void tone_reader::end_group(batch& groups, const incomplete_handler& take_incomplete)
{
    if (d_collector.end()) {
        const phase_group& group = d_collector.group();
        if (!group.is_complete() && take_incomplete)
            take_incomplete(groups.index.size(), group);
        groups.index.push_back(d_collector.index());
        groups.missing.push_back(group.missing());
        groups.rejected.push_back(group.rejected());
        groups.saturated.push_back(d_collector.saturated());
        d_collector.transform(d_transform.data());
        d_channel.append(d_transform.data(), groups.tones);
    }
    d_collector.clear();
}

} // namespace gr::wiforce::kernel
