// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_collector.h"

namespace gr::wiforce::kernel {

group_collector::group_collector(std::unique_ptr<doppler_transform> transform,
                                 int group_length,
                                 int symbol_length,
                                 std::shared_ptr<interference_screen> screen)
    : d_transform(std::move(transform)),
      d_group(group_length, symbol_length),
      d_screen(std::move(screen))
{
}

bool group_collector::must_end_before(std::uint64_t snapshot) const
{
    const std::uint64_t length = d_group.length();
    return d_group.decided() > 0 &&
           (snapshot / length != d_index ||
            snapshot % length < static_cast<std::uint64_t>(d_group.decided()));
}

bool group_collector::end()
{
    d_group.finish();
    if (d_transform->rejects_interference() || d_transform->passes_snapshots()) {
        const auto& marks = d_screen->examine(d_group);
        if (d_transform->rejects_interference() && d_screen->rejected() > 0)
            d_group.reject(marks);
    }
    return d_group.present() + d_group.rejected() > 0;
}

void group_collector::clear()
{
    d_group.clear();
    d_saturated = 0;
}

} // namespace gr::wiforce::kernel
