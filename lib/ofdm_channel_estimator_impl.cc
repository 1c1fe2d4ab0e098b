// SPDX-License-Identifier: GPL-3.0-or-later
#include "ofdm_channel_estimator_impl.h"

#include "kernel/require.h"
#include <gnuradio/io_signature.h>

#include <algorithm>

namespace gr::wiforce {

ofdm_channel_estimator::sptr
ofdm_channel_estimator::make(const std::vector<std::complex<double>>& factors, int rows)
{
    const kernel::channel_equalizer equalizer(factors);
    kernel::require(rows >= 1, "ofdm_channel_estimator", "rows", "must be >= 1", rows);
    return gnuradio::make_block_sptr<ofdm_channel_estimator_impl>(equalizer, rows);
}

ofdm_channel_estimator_impl::ofdm_channel_estimator_impl(
    const kernel::channel_equalizer& equalizer, int rows)
    : gr::sync_block(
          "ofdm_channel_estimator",
          gr::io_signature::make(1, 1, rows * kernel::FFT_LENGTH * sizeof(kernel::fc32)),
          gr::io_signature::make(1, 1, rows * kernel::FFT_LENGTH * sizeof(kernel::fc32))),
      d_equalizer(equalizer),
      d_rows(rows),
      d_fft(kernel::FFT_LENGTH)
{
}

int ofdm_channel_estimator_impl::work(int noutput_items,
                                      gr_vector_const_void_star& input_items,
                                      gr_vector_void_star& output_items)
{
    const auto* in = static_cast<const kernel::fc32*>(input_items[0]);
    auto* out = static_cast<kernel::fc32*>(output_items[0]);
    for (int row = 0; row < noutput_items * d_rows; row++) {
        std::copy_n(in + row * kernel::FFT_LENGTH, kernel::FFT_LENGTH, d_fft.get_inbuf());
        d_fft.execute();
        d_equalizer.equalize(d_fft.get_outbuf(), out + row * kernel::FFT_LENGTH);
    }
    return noutput_items;
}

} // namespace gr::wiforce
