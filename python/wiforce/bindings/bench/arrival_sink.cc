// SPDX-License-Identifier: GPL-3.0-or-later
#include "arrival_sink.h"

#include <gnuradio/io_signature.h>
#include <kernel/require.h>

#include <chrono>

namespace gr::wiforce::bench {

arrival_sink::sptr arrival_sink::make(int item_size)
{
    kernel::require(
        item_size >= 1, "arrival_sink", "item_size", "must be >= 1", item_size);
    return gnuradio::make_block_sptr<arrival_sink>(item_size);
}

arrival_sink::arrival_sink(int item_size)
    : gr::sync_block("arrival_sink",
                     gr::io_signature::make(1, 1, item_size),
                     gr::io_signature::make(0, 0, 0))
{
}

int arrival_sink::work(int noutput_items,
                       gr_vector_const_void_star&,
                       gr_vector_void_star&)
{
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    const std::lock_guard<std::mutex> lock(d_mutex);
    d_times.insert(
        d_times.end(), noutput_items, std::chrono::duration<double>(now).count());
    return noutput_items;
}

std::vector<double> arrival_sink::times() const
{
    const std::lock_guard<std::mutex> lock(d_mutex);
    return d_times;
}

} // namespace gr::wiforce::bench
