// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>

#include <cstdint>
#include <mutex>
#include <vector>

namespace gr::wiforce::bench {

// Produces zeros at the rate and in the packets of a radio, to measure latency. Each call
// of work() produces one packet, when its last sample would have been received.
class paced_source : public gr::sync_block
{
public:
    using sptr = std::shared_ptr<paced_source>;

    // The times of samples mark_every - 1, 2 mark_every - 1, ... are recorded; the stream
    // ends after `samples`; item_size is in bytes. Throws std::invalid_argument naming
    // parameter, rule and value.
    static sptr make(int packet_length,
                     double sample_rate,
                     std::uint64_t mark_every,
                     std::uint64_t samples,
                     int item_size = 8);
    paced_source(int packet_length,
                 double sample_rate,
                 std::uint64_t mark_every,
                 std::uint64_t samples,
                 int item_size);

    bool start() override;
    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

    // Seconds of the monotonic clock at which the packet of each marked sample went out.
    std::vector<double> mark_times() const;

private:
    const int d_packet_length;
    const double d_sample_rate;
    const std::uint64_t d_mark_every;
    const std::uint64_t d_samples;
    const int d_item_size;
    double d_start = 0; // seconds
    mutable std::mutex d_mutex;
    std::vector<double> d_marks;
};

} // namespace gr::wiforce::bench
