// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/block.h>
#include <gnuradio/wiforce/api.h>

#include <complex>
#include <cstdint>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Doppler tones, or the whole Doppler spectrum, of each phase group of snapshots.
 * \ingroup wiforce
 *
 * Input: a vector of 64 complex floats per snapshot. Output: a vector of M x 64 per phase
 * group of N_g snapshots,
 *
 *   P[m, k] = sum_n w[m, n] h[n, k].
 *
 * Group g holds the snapshots g N_g .. (g+1) N_g - 1 of the frame grid; the tag
 * `snapshot` on an input item says its index (the stream starts at 0 without one). Each
 * output carries the tag `group`. Where snapshots are absent, or hold values that are not
 * finite, they count as zeros, the output carries the tag `missing` with their number,
 * and the group's snapshots with their mask go out before it on the message port
 * `incomplete`, for who can do better than zeros. A group without any snapshot is not
 * emitted, nor is the unfinished last one. The tag `saturated` on inputs makes one with
 * their number on the output.
 *
 * The weights are applied as they are: how they were designed is not known here.
 */
class WIFORCE_API phase_group_doppler : virtual public gr::block
{
public:
    using sptr = std::shared_ptr<phase_group_doppler>;

    /*!
     * \param weights M x N_g weights, row by row
     * \param group_length snapshots per phase group, N_g
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(const std::vector<std::complex<double>>& weights, int group_length);

    /*!
     * The discrete Fourier transform over the group, scaled by 1/N_g: M = N_g rows in
     * natural FFT order, w[m, n] = exp(-2 pi j m n / N_g) / N_g.
     */
    static sptr spectrum(int group_length);

    //! Rows per output item, M.
    virtual int rows() const = 0;
    //! Groups emitted.
    virtual std::uint64_t groups() const = 0;
    //! Groups emitted with snapshots missing.
    virtual std::uint64_t incomplete_groups() const = 0;
};

} // namespace gr::wiforce
