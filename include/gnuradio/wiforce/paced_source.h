// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>
#include <gnuradio/wiforce/api.h>

#include <cstdint>
#include <vector>

namespace gr::wiforce {

/*!
 * \brief Gives zeros at the pace and in the packets of a radio: for measuring latency.
 * \ingroup wiforce
 *
 * Each call of work() gives one packet, when its last sample would have been taken. The
 * times at which chosen samples went out are kept.
 */
class WIFORCE_API paced_source : virtual public gr::sync_block
{
public:
    using sptr = std::shared_ptr<paced_source>;

    /*!
     * \param packet_length samples per packet
     * \param sample_rate samples per second
     * \param mark_every samples; the times of samples mark_every - 1, 2 mark_every - 1,
     * ... are kept \param samples after which the stream ends \param item_size bytes per
     * sample \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(int packet_length,
                     double sample_rate,
                     std::uint64_t mark_every,
                     std::uint64_t samples,
                     int item_size = 8);

    //! Seconds of the monotonic clock at which the packet of each marked sample went out.
    virtual std::vector<double> mark_times() const = 0;
};

} // namespace gr::wiforce
