// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>
#include <gnuradio/wiforce/api.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Reads the folded preambles of a recording.
 * \ingroup wiforce
 *
 * Equivalent to a file source followed by preamble_fold. Output: one vector of a symbol's
 * complex floats per frame, with the tag `snapshot` on the first one and on the first one
 * after every gap, the tag `saturated` on those of integer samples at full scale,
 * `retuned` on the first one behind a retuning, and the tag `noise` of preamble_fold.
 *
 * Frame timing is monitored as in preamble_fold. A file that is shorter than its segments
 * say, or is cut short while it is read, is read as far as it goes. For this, the signal
 * SIGBUS of the process gets a handler, which passes on what other pages cause.
 */
class WIFORCE_API recording_source : virtual public gr::sync_block
{
public:
    using sptr = std::shared_ptr<recording_source>;

    //! File offset in samples, index in the stream, length in samples.
    using segment = std::array<std::uint64_t, 3>;

    /*!
     * \param path data file
     * \param datatype "ci16_le" or "cf32_le"
     * \param segments unbroken runs of samples in order; between two, samples were lost
     * \param frame_length samples per frame, at least first_averaged + symbol_length
     *        repetitions
     * \param first_averaged first averaged sample of a frame
     * \param repetitions repetitions of the symbol that are averaged
     * \param frame_offset samples from the first segment's start to the first frame
     * \param header_bytes bytes of the file before its first sample
     * \param symbol_length samples of the symbol, 16 to 4096
     * \param retuned numbers of the segments, the first being 0, before which the device
     *        was retuned or opened again
     * \throws std::invalid_argument naming file or parameter, rule and value
     */
    static sptr make(const std::string& path,
                     const std::string& datatype,
                     const std::vector<segment>& segments,
                     int frame_length,
                     int first_averaged = 64,
                     int repetitions = 4,
                     std::uint64_t frame_offset = 0,
                     std::uint64_t header_bytes = 0,
                     int symbol_length = 64,
                     const std::vector<std::size_t>& retuned = {});

    //! Frames folded so far.
    virtual std::uint64_t snapshots() const = 0;
    //! Times that frame timing slipped: samples were lost or repeated that no segment
    //! reports.
    virtual std::uint64_t frames_moved() const = 0;
    //! Samples that the segments promise and the file does not hold.
    virtual std::uint64_t samples_missing() const = 0;
};

} // namespace gr::wiforce
