// SPDX-License-Identifier: GPL-3.0-or-later
#include "rx_time.h"

namespace gr::wiforce {

std::optional<kernel::timeline::time> rx_time_value(const pmt::pmt_t& value)
{
    if (!pmt::is_tuple(value) || pmt::length(value) != 2)
        return std::nullopt;
    const pmt::pmt_t seconds = pmt::tuple_ref(value, 0);
    const pmt::pmt_t fraction = pmt::tuple_ref(value, 1);
    const bool is_whole = pmt::is_uint64(seconds) ||
                          (pmt::is_integer(seconds) && pmt::to_long(seconds) >= 0);
    if (!is_whole || !pmt::is_real(fraction))
        return std::nullopt;
    return kernel::timeline::time{ pmt::to_uint64(seconds), pmt::to_double(fraction) };
}

} // namespace gr::wiforce
