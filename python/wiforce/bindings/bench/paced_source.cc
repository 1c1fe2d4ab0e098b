// SPDX-License-Identifier: GPL-3.0-or-later
#include "paced_source.h"

#include <gnuradio/io_signature.h>
#include <kernel/require.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <thread>

#ifdef __linux__
#include <sys/prctl.h>
#endif

namespace gr::wiforce::bench {

namespace {
using clock = std::chrono::steady_clock;

double now()
{
    return std::chrono::duration<double>(clock::now().time_since_epoch()).count();
}
} // namespace

paced_source::sptr paced_source::make(int packet_length,
                                      double sample_rate,
                                      std::uint64_t mark_every,
                                      std::uint64_t samples,
                                      int item_size)
{
    const char* where = "paced_source";
    using kernel::require;
    require(packet_length >= 1, where, "packet_length", "must be >= 1", packet_length);
    require(std::isfinite(sample_rate) && sample_rate > 0,
            where,
            "sample_rate",
            "must be positive",
            sample_rate);
    require(mark_every >= 1, where, "mark_every", "must be >= 1", mark_every);
    require(item_size >= 1, where, "item_size", "must be >= 1", item_size);
    return gnuradio::make_block_sptr<paced_source>(
        packet_length, sample_rate, mark_every, samples, item_size);
}

paced_source::paced_source(int packet_length,
                           double sample_rate,
                           std::uint64_t mark_every,
                           std::uint64_t samples,
                           int item_size)
    : gr::sync_block("paced_source",
                     gr::io_signature::make(0, 0, 0),
                     gr::io_signature::make(1, 1, item_size)),
      d_packet_length(packet_length),
      d_sample_rate(sample_rate),
      d_mark_every(mark_every),
      d_samples(samples),
      d_item_size(item_size)
{
    set_output_multiple(packet_length);
}

bool paced_source::start()
{
    d_start = now();
    return true;
}

int paced_source::work(int, gr_vector_const_void_star&, gr_vector_void_star& output_items)
{
    const std::uint64_t begin = nitems_written(0), end = begin + d_packet_length;
    if (begin >= d_samples)
        return WORK_DONE;
#ifdef __linux__
    if (begin == 0)
        prctl(PR_SET_TIMERSLACK, 1); // of this thread; the default adds 50 us
#endif
    std::this_thread::sleep_until(
        clock::time_point(std::chrono::duration_cast<clock::duration>(
            std::chrono::duration<double>(d_start + end / d_sample_rate))));
    std::memset(
        output_items[0], 0, static_cast<std::size_t>(d_packet_length) * d_item_size);
    if (end / d_mark_every > begin / d_mark_every) {
        const std::lock_guard<std::mutex> lock(d_mutex);
        for (auto mark = begin / d_mark_every; mark < end / d_mark_every; mark++)
            d_marks.push_back(now());
    }
    return d_packet_length;
}

std::vector<double> paced_source::mark_times() const
{
    const std::lock_guard<std::mutex> lock(d_mutex);
    return d_marks;
}

} // namespace gr::wiforce::bench
