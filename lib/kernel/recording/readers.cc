// SPDX-License-Identifier: GPL-3.0-or-later
#include "readers.h"

#include "../require.h"

#include <sched.h>

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <future>

namespace gr::wiforce::kernel {

namespace {

// Groups between two times that all workers wait for each other.
constexpr std::size_t ROUND = 256;
// Beside the threads that separate and read what they fold, two keep two cores busy.
constexpr int MOST_WORKERS = 2;

// Processors that this thread may run on.
int usable_processors()
{
    cpu_set_t usable;
    return sched_getaffinity(0, sizeof(usable), &usable) == 0 ? CPU_COUNT(&usable) : 1;
}

} // namespace

folded_reader::folded_reader(std::unique_ptr<recorded_frames> frames)
    : d_frames(std::move(frames)), d_reader(*d_frames)
{
}

folded_reader::batch folded_reader::read(std::size_t max_frames)
{
    const std::lock_guard<std::mutex> one_at_a_time(d_mutex);
    batch frames;
    const std::size_t length = d_frames->symbol_length();
    while (frames.snapshot.size() < max_frames && d_reader.fill()) {
        const std::size_t before = frames.snapshot.size();
        const std::uint64_t first = d_reader.rest().frame;
        const std::size_t most =
            std::min<std::uint64_t>(d_reader.rest().count, max_frames - before);
        frames.folded.resize((before + most) * length);
        frames.noise.resize(before + most);
        const std::size_t count =
            d_reader.fold(most, &frames.folded[before * length], &frames.noise[before]);
        for (std::size_t n = 0; n < count; n++)
            frames.snapshot.push_back(first + n);
        frames.saturated.resize(before + count);
        for (const int frame : d_reader.saturated())
            frames.saturated[before + frame] = 1;
    }
    frames.folded.resize(frames.snapshot.size() * length);
    frames.noise.resize(frames.snapshot.size());
    return frames;
}

// What folds groups beside others: one of a recording's groups at a time.
struct tone_reader::worker {
    worker(recorded_frames& frames,
           std::unique_ptr<doppler_transform> accumulator,
           int group_length,
           std::shared_ptr<interference_screen> screen,
           std::unique_ptr<channel_equalizer> to_channel)
        : reader(frames),
          collector(std::move(accumulator), group_length, frames.symbol_length(), screen),
          channel(std::move(to_channel)),
          transform(collector.size())
    {
    }

    std::vector<frame_run> runs; // of the group
    frame_reader reader;
    group_collector collector;
    const std::unique_ptr<channel_equalizer> channel;
    std::vector<fc32> transform; // rows x symbol_length
};

// Groups that are folded side by side, and screened in turns.
struct tone_reader::round {
    explicit round(std::size_t count) : groups(count) {}

    const std::size_t groups;
    std::mutex mutex;
    std::condition_variable next;
    std::size_t begun = 0, screened = 0;
    bool ended = false; // the recording
    std::exception_ptr failure = nullptr;
};

tone_reader::tone_reader(std::unique_ptr<recorded_frames> frames,
                         const std::vector<std::complex<double>>& weights,
                         int group_length,
                         const std::vector<std::complex<double>>& factors,
                         const std::vector<std::complex<double>>& rotation,
                         const std::vector<int>& bins)
    : d_frames(std::move(frames)), d_group_length(group_length), d_bins(bins)
{
    const int symbol_length = d_frames->symbol_length();
    const tone_accumulator accumulator(weights, group_length, symbol_length);
    d_rows = accumulator.rows();
    const auto screen =
        std::make_shared<interference_screen>(group_length, symbol_length);
    // To hand over groups that are read at once takes as long as to fold them.
    const bool alone = d_frames->span(group_length) <= d_frames->read_at_once();
    const int workers = alone ? 1 : std::min(MOST_WORKERS, usable_processors());
    for (int n = 0; n < workers; n++)
        d_workers.push_back(std::make_unique<worker>(
            *d_frames,
            std::make_unique<tone_accumulator>(accumulator),
            group_length,
            screen,
            std::make_unique<channel_equalizer>(factors, d_rows, rotation, bins)));
    require(d_workers[0]->channel->symbol_length() == symbol_length,
            "tone_reader: factors must be as many as a symbol has samples, " +
                std::to_string(symbol_length),
            d_workers[0]->channel->symbol_length());
}

tone_reader::~tone_reader() = default;

tone_reader::batch tone_reader::read(std::size_t max_groups,
                                     const incomplete_handler& take_incomplete)
{
    const std::lock_guard<std::mutex> one_at_a_time(d_mutex);
    batch groups;
    bool ended = false;
    while (groups.index.size() < max_groups && !ended) {
        round now(std::min(ROUND, max_groups - groups.index.size()));
        groups.tones.resize((groups.index.size() + now.groups) * values());
        std::vector<std::future<void>> others;
        for (std::size_t n = 1; n < d_workers.size(); n++)
            others.push_back(std::async(std::launch::async, [&, n] {
                work(*d_workers[n], now, groups, take_incomplete);
            }));
        work(*d_workers[0], now, groups, take_incomplete);
        for (const auto& other : others)
            other.wait();
        if (now.failure)
            std::rethrow_exception(now.failure);
        groups.tones.resize(groups.index.size() * values());
        ended = now.ended;
    }
    return groups;
}

// Takes the runs of the next group's frames; false where the recording ends before it.
bool tone_reader::take_group(std::vector<frame_run>& runs)
{
    const std::uint64_t length = d_group_length;
    runs.clear();
    std::uint64_t end = 0; // of the frames taken
    while (const std::uint64_t ready = d_frames->ready()) {
        const std::uint64_t frame = d_frames->frame();
        if (!runs.empty() && (frame / length != (end - 1) / length || frame < end))
            return true;
        runs.push_back(d_frames->take(std::min(ready, length - frame % length)));
        end = frame + runs.back().count;
        if (end % length == 0)
            return true;
    }
    return false;
}

void tone_reader::work(worker& by,
                       round& now,
                       batch& groups,
                       const incomplete_handler& take_incomplete)
{
    std::unique_lock<std::mutex> lock(now.mutex);
    try {
        while (now.begun < now.groups && !now.ended && !now.failure) {
            const bool whole = take_group(by.runs);
            now.ended = !whole;
            const std::size_t turn = now.begun++;
            lock.unlock();
            fold(by);
            lock.lock();
            now.next.wait(lock, [&] { return now.screened == turn || now.failure; });
            if (now.failure)
                return;
            lock.unlock();
            const std::size_t row = groups.index.size();
            const bool any = whole && end_group(by.collector, groups, take_incomplete);
            lock.lock();
            now.screened++;
            now.next.notify_all();
            lock.unlock();
            if (any) {
                by.collector.transform(by.transform.data());
                by.channel->write(by.transform.data(), &groups.tones[row * values()]);
            }
            by.collector.clear();
            lock.lock();
        }
    } catch (...) {
        if (!lock.owns_lock())
            lock.lock();
        now.failure = std::current_exception();
        now.next.notify_all();
    }
}

void tone_reader::fold(worker& by)
{
    for (const frame_run& run : by.runs) {
        by.reader.begin(run);
        for (int added = 1; added > 0 && by.reader.rest().count > 0;) {
            added = by.collector.add(by.reader.rest().frame,
                                     by.reader.rest().count,
                                     [&](int most, fc32* folded, snapshot_noise* noise) {
                                         return by.reader.fold(most, folded, noise);
                                     });
            by.collector.note_saturated(by.reader.saturated().size());
        }
    }
}

// Ends a group in its turn, and notes it unless it has no snapshot.
bool tone_reader::end_group(group_collector& collector,
                            batch& groups,
                            const incomplete_handler& take_incomplete)
{
    if (!collector.end())
        return false;
    const phase_group& group = collector.group();
    if (!group.is_complete() && take_incomplete)
        take_incomplete(groups.index.size(), group);
    groups.index.push_back(collector.index());
    groups.missing.push_back(group.missing());
    groups.rejected.push_back(group.rejected());
    groups.saturated.push_back(collector.saturated());
    return true;
}

} // namespace gr::wiforce::kernel
