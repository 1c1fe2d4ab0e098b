// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/wiforce/arrival_sink.h>

#include <mutex>

namespace gr::wiforce {

class arrival_sink_impl : public arrival_sink
{
public:
    explicit arrival_sink_impl(int item_size);

    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;
    std::vector<double> times() const override;

private:
    mutable std::mutex d_mutex;
    std::vector<double> d_times;
};

} // namespace gr::wiforce
