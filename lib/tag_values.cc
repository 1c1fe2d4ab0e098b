// SPDX-License-Identifier: GPL-3.0-or-later
#include "tag_values.h"

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

void noise_tags::add(const std::vector<gr::tag_t>& tags)
{
    for (const gr::tag_t& tag : tags)
        if (pmt::is_f32vector(tag.value))
            d_runs.push_back({ tag.offset, pmt::f32vector_elements(tag.value) });
}

void noise_tags::write(std::uint64_t first, int count, kernel::snapshot_noise* noise)
{
    for (int n = 0; n < count; n++) {
        while (!d_runs.empty() && d_runs.front().end() <= first + n)
            d_runs.pop_front();
        noise[n] = {};
        if (!d_runs.empty() && d_runs.front().first <= first + n) {
            const float* values =
                &d_runs.front().values[2 * (first + n - d_runs.front().first)];
            noise[n] = { values[0], values[1] };
        }
    }
}

} // namespace gr::wiforce
