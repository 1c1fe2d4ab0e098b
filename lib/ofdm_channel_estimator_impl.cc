// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fourier/channel_equalizer.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/ofdm_channel_estimator.h>

#include <memory>

namespace gr::wiforce {

static gr::io_signature::sptr vector_signature(const kernel::channel_equalizer& equalizer)
{
    return gr::io_signature::make(
        1, 1, equalizer.rows() * equalizer.symbol_length() * sizeof(kernel::fc32));
}

class ofdm_channel_estimator_impl : public ofdm_channel_estimator
{
public:
    explicit ofdm_channel_estimator_impl(
        std::unique_ptr<kernel::channel_equalizer> equalizer)
        : gr::sync_block("ofdm_channel_estimator",
                         vector_signature(*equalizer),
                         vector_signature(*equalizer)),
          d_equalizer(std::move(equalizer))
    {
    }

    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override
    {
        const auto* in = static_cast<const kernel::fc32*>(input_items[0]);
        auto* out = static_cast<kernel::fc32*>(output_items[0]);
        const int rows = d_equalizer->rows();
        for (int row = 0; row < noutput_items * rows; row++) {
            const std::size_t at = std::size_t(row) * d_equalizer->symbol_length();
            d_equalizer->equalize(row % rows, in + at, out + at);
        }
        return noutput_items;
    }

private:
    const std::unique_ptr<kernel::channel_equalizer> d_equalizer;
};

ofdm_channel_estimator::sptr
ofdm_channel_estimator::make(const std::vector<std::complex<double>>& factors,
                             int rows,
                             const std::vector<std::complex<double>>& rotation)
{
    return gnuradio::make_block_sptr<ofdm_channel_estimator_impl>(
        std::make_unique<kernel::channel_equalizer>(factors, rows, rotation));
}

} // namespace gr::wiforce
