// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <vector>

namespace gr::wiforce::kernel {

// The value at `index` of the sorted values, which are sorted in part; it lies among the
// first `candidates`: a call for a lower one is faster after one for a higher one.
inline float
ordered(std::vector<float>& values, std::size_t candidates, std::size_t index)
{
    // Values among which the rest is found, and divisions of them.
    constexpr std::size_t FEW = 16;
    constexpr int ROUNDS = 12;
    // std::nth_element guesses the outcome of comparisons that nobody can guess. Values
    // are divided here without a branch, until few are left.
    std::size_t first = 0, last = candidates;
    for (int round = 0; round < ROUNDS && last - first > FEW; round++) {
        const float a = values[first], b = values[(first + last) / 2];
        const float c = values[last - 1];
        const float pivot = std::max(std::min(a, b), std::min(std::max(a, b), c));
        std::size_t below = first;
        for (std::size_t n = first; n < last; n++) {
            const float value = values[n];
            values[n] = values[below];
            values[below] = value;
            below += value < pivot;
        }
        (index < below ? last : first) = below;
    }
    const auto at = values.begin() + index;
    std::nth_element(values.begin() + first, at, values.begin() + last);
    return *at;
}

// Quantile `part` of values, which are sorted in part.
inline float quantile(std::vector<float>& values, double part)
{
    return ordered(values, values.size(), part * (values.size() - 1));
}

/*
 * The typical value of a quantity that each phase group measures once, by the lower
 * quantile over the latest groups. It is valid while most of them are hit by
 * interference, which raises the quantity.
 */
class recent_level
{
public:
    explicit recent_level(int group_length)
        : d_groups((WINDOW + group_length - 1) / group_length)
    {
    }

    void add(float value)
    {
        d_values.push_back(value);
        if (d_values.size() > d_groups)
            d_values.pop_front();
        std::vector<float> values(d_values.begin(), d_values.end());
        d_level = quantile(values, GROUP_QUANTILE);
    }
    bool is_known() const { return !d_values.empty(); }
    // 0 before the first add().
    float value() const { return d_level; }

private:
    // Snapshots over which the level of the noise is learned: seven groups of the default
    // length, .24 s. A receiver whose noise rises for good loses five groups of that
    // length; with three groups in the window it would lose two, but read a stretch of
    // loud interference of .15 s (and take it for a motion of the tag).
    static constexpr int WINDOW = 4096;
    // Quantile over the groups of the window that is their level. Short groups that are
    // hit as a whole are then rejected as long as they are fewer than three quarters.
    static constexpr double GROUP_QUANTILE = 0.25;

    const std::size_t d_groups;
    std::deque<float> d_values;
    float d_level = 0;
};

} // namespace gr::wiforce::kernel
