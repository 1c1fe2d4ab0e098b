// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cstddef>
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

} // namespace gr::wiforce::kernel
