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
 * Input: a vector of symbol_length complex floats per snapshot. Output: a vector of
 * M x symbol_length per phase group of N_g snapshots,
 *
 *   P[m, k] = sum_n w[m, n] h[n, k].
 *
 * Group g holds the snapshots g N_g .. (g+1) N_g - 1 of the frame grid; the tag
 * `snapshot` on an input item is its index (without one the stream starts at 0). Each
 * output carries the tag `group`. Missing snapshots, and those with values that are not
 * finite, count as zeros, and so do those that another transmitter interfered with (not
 * in a spectrum): the tag `noise` of the inputs shows them. The output then carries the
 * tag `missing` with the number of the former or `rejected` with that of the latter, and
 * the group's snapshots and their mask are published before it on the message port
 * `incomplete`, for blocks that can do better than zeros. A group without any snapshot is
 * not emitted, nor is the unfinished last one. The output's tag `saturated` counts the
 * inputs that carry one.
 *
 * The weights are applied as given; this block does not design them.
 */
class WIFORCE_API phase_group_doppler : virtual public gr::block
{
public:
    using sptr = std::shared_ptr<phase_group_doppler>;

    /*!
     * \param weights M x N_g weights, row by row
     * \param group_length snapshots per phase group, N_g
     * \param symbol_length samples of a snapshot, 16 to 4096
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(const std::vector<std::complex<double>>& weights,
                     int group_length,
                     int symbol_length = 64);

    /*!
     * The discrete Fourier transform over the group, scaled by 1/N_g: M = N_g rows in
     * natural FFT order, w[m, n] = exp(-2 pi j m n / N_g) / N_g.
     */
    static sptr spectrum(int group_length, int symbol_length = 64);

    /*!
     * The snapshots of the group themselves, M = N_g rows, absent ones as zeros. None is
     * rejected and nothing is published: the output's tag `mask` of an incomplete group
     * shows which are present, and `disturbed` those that interference hit.
     */
    static sptr collected(int group_length, int symbol_length = 64);

    //! Rows per output item, M.
    virtual int rows() const = 0;
    //! Groups emitted.
    virtual std::uint64_t groups() const = 0;
    //! Groups emitted with snapshots missing.
    virtual std::uint64_t incomplete_groups() const = 0;
};

} // namespace gr::wiforce
