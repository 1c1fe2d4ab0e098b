// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <deque>
#include <vector>

namespace gr::wiforce::kernel {

// The value at `index` of the sorted values, which are sorted in part; it lies among the
// first `candidates`: a call for a lower one is faster after one for a higher one.
float ordered(std::vector<float>& values, std::size_t candidates, std::size_t index);

// Quantile `part` of values, which are sorted in part.
float quantile(std::vector<float>& values, double part);

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
