// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/wiforce/paced_source.h>

#include <mutex>

namespace gr::wiforce {

class paced_source_impl : public paced_source
{
public:
    paced_source_impl(int packet_length,
                      double sample_rate,
                      std::uint64_t mark_every,
                      std::uint64_t samples,
                      int item_size);

    bool start() override;
    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;
    std::vector<double> mark_times() const override;

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

} // namespace gr::wiforce
