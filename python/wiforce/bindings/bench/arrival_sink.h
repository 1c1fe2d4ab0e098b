// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>

#include <mutex>
#include <vector>

namespace gr::wiforce::bench {

// Records the time at which each item arrives, to measure latency with paced_source. A
// Python block in its place would add a quarter of a millisecond of its own.
class arrival_sink : public gr::sync_block
{
public:
    using sptr = std::shared_ptr<arrival_sink>;

    // item_size: bytes per item. Throws std::invalid_argument naming parameter, rule and
    // value.
    static sptr make(int item_size);
    explicit arrival_sink(int item_size);

    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

    // Seconds of the monotonic clock at which each item arrived.
    std::vector<double> times() const;

private:
    mutable std::mutex d_mutex;
    std::vector<double> d_times;
};

} // namespace gr::wiforce::bench
