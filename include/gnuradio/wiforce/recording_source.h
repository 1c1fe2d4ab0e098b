// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/block.h>
#include <gnuradio/wiforce/api.h>

#include <array>
#include <complex>
#include <cstdint>
#include <string>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Reads a recording straight from the file's memory: folded vectors, or tones of
 * phase groups.
 * \ingroup wiforce
 *
 * In the first form it stands for a file source and preamble_fold: one vector of 64
 * complex floats per frame, with the tag `snapshot` on the first one and on the first
 * after every gap, and `saturated` on those of integers at full scale. In the second form
 * (tones) it stands for phase_group_doppler as well, with that block's output, tags and
 * message port `incomplete`.
 *
 * Only samples that are averaged are read from the file, and 16 frames in 1024 on which
 * it is seen that they stay in their place (see preamble_fold). A file that is shorter
 * than its segments say is read as far as it goes.
 */
class WIFORCE_API recording_source : virtual public gr::block
{
public:
    using sptr = std::shared_ptr<recording_source>;

    //! File offset in samples, index in the stream, length in samples.
    using segment = std::array<std::uint64_t, 3>;

    /*!
     * \param path data file
     * \param datatype "ci16_le" or "cf32_le"
     * \param segments unbroken runs of samples in order; between two, samples were lost
     * \param frame_length samples per frame, at least first_averaged + 64 repetitions
     * \param first_averaged first averaged sample of a frame
     * \param repetitions repetitions of 64 samples that are averaged
     * \param frame_offset samples from the first segment's start to the first frame
     * \param header_bytes bytes of the file before its first sample
     * \throws std::invalid_argument naming file or parameter, rule and value
     */
    static sptr make(const std::string& path,
                     const std::string& datatype,
                     const std::vector<segment>& segments,
                     int frame_length,
                     int first_averaged = 64,
                     int repetitions = 4,
                     std::uint64_t frame_offset = 0,
                     std::uint64_t header_bytes = 0);

    /*!
     * The second form.
     * \param weights M x N_g weights, row by row, as of phase_group_doppler
     * \param group_length snapshots per phase group, N_g
     */
    static sptr tones(const std::string& path,
                      const std::string& datatype,
                      const std::vector<segment>& segments,
                      const std::vector<std::complex<double>>& weights,
                      int group_length,
                      int frame_length,
                      int first_averaged = 64,
                      int repetitions = 4,
                      std::uint64_t frame_offset = 0,
                      std::uint64_t header_bytes = 0);

    //! Frames folded so far.
    virtual std::uint64_t snapshots() const = 0;
    //! Times that frames came elsewhere, because samples were lost or repeated of which
    //! no segment told.
    virtual std::uint64_t frames_moved() const = 0;
    //! Samples that the segments promise and the file does not hold.
    virtual std::uint64_t samples_missing() const = 0;
};

} // namespace gr::wiforce
