// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/block.h>
#include <gnuradio/wiforce/api.h>

#include <complex>
#include <cstdint>
#include <string>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Averages the repeated part of each sounding frame.
 * \ingroup wiforce
 *
 * Input: samples, complex float (fc32) or complex int16 (sc16, scaled by 1/32768).
 * Output, first form: one vector of symbol_length complex floats per frame, the mean over
 * the repetitions. Output, second form (tones): that of phase_group_doppler, with its
 * tags and message port `incomplete`, computed in one thread, which is faster.
 *
 * Frames lie on a grid that starts at \p frame_offset; the block does not search for the
 * first one. A tag `rx_time` later than the samples before it account for reports lost
 * samples (an overflow): frames that miss averaged samples are dropped, and the next
 * whole frame of the same grid follows. While a tag `rx_rate` differs from \p
 * sample_rate, or `rx_freq` from the first one, samples are discarded; so are all until
 * the first `rx_freq` that is close to the expected carrier, where one is expected.
 *
 * Frame timing is monitored: when samples were lost or repeated and no tag reports it,
 * the frames are found again as soon as two averages over 16 frames agree on the shift.
 * The number of samples lost is then known modulo the frame length.
 *
 * In the first form the first output and the first one after every gap carry the tag
 * `snapshot`, the index of that frame on the grid. Outputs of sc16 samples at full scale
 * carry the tag `saturated`, and the first one after another rate or carrier `retuned`.
 * The tag `noise` holds two floats for its output and each of those that follow: the
 * smallest and the largest difference between the averaged repetitions, as a power per
 * sample, which show interference. In the second form interference is rejected here.
 * Input tags are not propagated, since their offsets divided by the frame length mean
 * nothing once samples were lost.
 */
class WIFORCE_API preamble_fold : virtual public gr::block
{
public:
    using sptr = std::shared_ptr<preamble_fold>;

    /*!
     * \param frame_length samples per frame, at least first_averaged + symbol_length
     *        repetitions
     * \param first_averaged first averaged sample of a frame
     * \param repetitions repetitions of the symbol that are averaged
     * \param sample_rate samples per second, to interpret `rx_time`
     * \param frame_offset samples before the first frame
     * \param item_type "fc32" or "sc16"
     * \param symbol_length samples of the symbol, 16 to 4096
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(int frame_length,
                     int first_averaged = 64,
                     int repetitions = 4,
                     double sample_rate = 12.5e6,
                     std::uint64_t frame_offset = 0,
                     const std::string& item_type = "fc32",
                     int symbol_length = 64);

    /*!
     * The second form.
     * \param weights M x N_g weights, row by row, as of phase_group_doppler
     * \param group_length snapshots per phase group, N_g
     */
    static sptr tones(const std::vector<std::complex<double>>& weights,
                      int group_length,
                      int frame_length,
                      int first_averaged = 64,
                      int repetitions = 4,
                      double sample_rate = 12.5e6,
                      std::uint64_t frame_offset = 0,
                      const std::string& item_type = "fc32",
                      int symbol_length = 64);

    /*!
     * The third form: output and tags are those of phase_group_doppler::collected.
     * \param group_length snapshots per phase group, N_g
     */
    static sptr collected(int group_length,
                          int frame_length,
                          int first_averaged = 64,
                          int repetitions = 4,
                          double sample_rate = 12.5e6,
                          std::uint64_t frame_offset = 0,
                          const std::string& item_type = "fc32",
                          int symbol_length = 64);

    //! Expects a carrier in Hz, to 0.1 % as sensor models do; before the flowgraph
    //! starts.
    virtual void expect_carrier(double frequency_hz) = 0;
    //! Rate and carrier that tags report now, for which samples are discarded; 0 for
    //! those that are right.
    virtual double refused_rate() const = 0;
    virtual double refused_carrier() const = 0;

    //! Frames folded so far.
    virtual std::uint64_t snapshots() const = 0;

    //! Gaps that `rx_time` reported.
    virtual std::uint64_t gaps() const = 0;
    //! Samples lost in them.
    virtual std::uint64_t samples_lost() const = 0;
    //! Values of `rx_time` that were malformed or implausible, and ignored.
    virtual std::uint64_t times_ignored() const = 0;

    //! Times that frame timing slipped without a report by `rx_time`.
    virtual std::uint64_t frames_moved() const = 0;
    //! Samples that count as lost in these slips, known modulo the frame length.
    virtual std::uint64_t samples_moved() const = 0;

    //! Mean of the first 1000 frames, guards included, in units of the samples; empty
    //! while they are not complete, and where samples are missing among them.
    virtual std::vector<std::complex<double>> mean_frame() const = 0;
};

} // namespace gr::wiforce
