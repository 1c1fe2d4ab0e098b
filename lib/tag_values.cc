// SPDX-License-Identifier: GPL-3.0-or-later
#include "noise_tags.h"

namespace gr::wiforce {

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
