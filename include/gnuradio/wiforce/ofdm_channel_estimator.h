// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>
#include <gnuradio/wiforce/api.h>

#include <complex>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Estimates the channel on each subcarrier from folded preambles.
 * \ingroup wiforce
 *
 * Input and output: vectors of rows x N complex floats, N = 64 for the default
 * waveform. Each row goes through an N-point FFT and is multiplied by \p factors: H[k] =
 * FFT(x)[k] factors[k], k in natural FFT order. Factors of zero leave unoccupied
 * subcarriers at zero.
 *
 * Folding, Doppler tones and this estimate are linear and commute. After preamble_fold
 * (rows = 1) it gives the channel of each snapshot; after phase_group_doppler (rows = M)
 * it gives that of each tone at a fraction of the cost.
 */
class WIFORCE_API ofdm_channel_estimator : virtual public gr::sync_block
{
public:
    using sptr = std::shared_ptr<ofdm_channel_estimator>;

    /*!
     * \param factors N factors, 1 / (X_k N / sqrt K) on occupied subcarriers, else 0
     * \param rows rows per vector
     * \param rotation rows x N values by which the samples are multiplied before the
     *        FFT, or none: the phase of a tone at f advances by 2 pi f / sample_rate from
     *        one folded sample to the next, which leaks into neighbouring subcarriers
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(const std::vector<std::complex<double>>& factors,
                     int rows = 1,
                     const std::vector<std::complex<double>>& rotation = {});
};

} // namespace gr::wiforce
