// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/fourier/channel_equalizer.h"
#include <gnuradio/wiforce/ofdm_channel_estimator.h>

#include <memory>

namespace gr::wiforce {

class ofdm_channel_estimator_impl : public ofdm_channel_estimator
{
public:
    explicit ofdm_channel_estimator_impl(
        std::unique_ptr<kernel::channel_equalizer> equalizer);

    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

private:
    const std::unique_ptr<kernel::channel_equalizer> d_equalizer;
};

} // namespace gr::wiforce
