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
 * \brief Folds the repeated part of each sounding frame: one vector of 64 samples, or
 * tones of phase groups.
 * \ingroup wiforce
 *
 * Input: samples, complex float (fc32) or complex int16 (sc16, scaled by 1/32768).
 * Output, first form: one vector of 64 complex floats per frame, the mean over the
 * repetitions. Second form (tones): what phase_group_doppler makes of those, with its
 * tags and message port `incomplete`, but in one thread, which is faster.
 *
 * Frames lie on a grid that starts at \p frame_offset. A tag `rx_time` that is later than
 * the samples before it account for means lost samples (an overflow): the frames that
 * miss averaged samples are dropped and the next whole one of the same grid follows. When
 * a tag `rx_rate` differs from \p sample_rate, or `rx_freq` from the first one, nothing
 * is read until it is set back. In the first form the first output and the first one
 * after every gap carry the tag `snapshot`, the index of that frame on the grid; outputs
 * of sc16 samples at full scale carry the tag `saturated`, and the first one after
 * another rate or carrier `retuned`. Input tags are not passed on: 1/frame_length of
 * their offsets means nothing once samples were lost.
 *
 * The block does not find the first frame: \p frame_offset says where it is. When frames
 * come elsewhere later, because samples were lost or repeated of which no tag told, it
 * follows them: two averages over 16 frames must agree on the shift. How many samples it
 * were is known but for whole frames. Frames of more than 8192 samples are not watched.
 */
class WIFORCE_API preamble_fold : virtual public gr::block
{
public:
    using sptr = std::shared_ptr<preamble_fold>;

    /*!
     * \param frame_length samples per frame, at least first_averaged + 64 repetitions
     * \param first_averaged first averaged sample of a frame
     * \param repetitions repetitions of 64 samples that are averaged
     * \param sample_rate samples per second, by which `rx_time` is read
     * \param frame_offset samples before the first frame
     * \param item_type "fc32" or "sc16"
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(int frame_length,
                     int first_averaged = 64,
                     int repetitions = 4,
                     double sample_rate = 12.5e6,
                     std::uint64_t frame_offset = 0,
                     const std::string& item_type = "fc32");

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
                      const std::string& item_type = "fc32");

    //! Frames folded so far.
    virtual std::uint64_t snapshots() const = 0;

    //! Times that `rx_time` told of lost samples.
    virtual std::uint64_t gaps() const = 0;
    //! Samples lost then.
    virtual std::uint64_t samples_lost() const = 0;
    //! Values of `rx_time` that were no time, or one that could not be.
    virtual std::uint64_t times_ignored() const = 0;

    //! Times that frames came elsewhere, of which no `rx_time` told.
    virtual std::uint64_t frames_moved() const = 0;
    //! Samples that count as lost then: as many as were, but for whole frames.
    virtual std::uint64_t samples_moved() const = 0;
};

} // namespace gr::wiforce
