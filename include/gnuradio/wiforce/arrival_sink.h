// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/sync_block.h>
#include <gnuradio/wiforce/api.h>

#include <vector>

namespace gr::wiforce {

/*!
 * \brief Keeps the time at which each item comes: for measuring latency, with
 * paced_source.
 * \ingroup wiforce
 *
 * A Python block in its place would add a quarter of a millisecond of its own.
 */
class WIFORCE_API arrival_sink : virtual public gr::sync_block
{
public:
    using sptr = std::shared_ptr<arrival_sink>;

    /*!
     * \param item_size bytes per item
     * \throws std::invalid_argument naming parameter, rule and value
     */
    static sptr make(int item_size);

    //! Seconds of the monotonic clock at which each item came.
    virtual std::vector<double> times() const = 0;
};

} // namespace gr::wiforce
