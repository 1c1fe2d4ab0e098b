// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <deque>

namespace gr::wiforce::kernel {

/*
 * The typical value of a quantity that each phase group measures once, by the lower
 * quantile over the latest groups. It is valid while most of them are hit by
 * interference, which raises the quantity.
 */
class recent_level
{
public:
    explicit recent_level(int group_length);

    void add(float value);
    bool is_known() const { return !d_values.empty(); }
    // 0 before the first add().
    float value() const { return d_level; }

private:
    const std::size_t d_groups;
    std::deque<float> d_values;
    float d_level = 0;
};

} // namespace gr::wiforce::kernel
