// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/timing/timeline.h"
#include <gnuradio/wiforce/api.h>
#include <pmt/pmt.h>

#include <optional>

namespace gr::wiforce {

// The time in the value of an rx_time tag, a tuple(uint64 seconds, double fraction) as
// gr-uhd makes it; nothing when it is anything else. Python blocks use the same rule.
WIFORCE_API std::optional<kernel::timeline::time> rx_time_value(const pmt::pmt_t& value);

} // namespace gr::wiforce
