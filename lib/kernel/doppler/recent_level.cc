// SPDX-License-Identifier: GPL-3.0-or-later
#include "recent_level.h"
#include "order_statistics.h"

namespace gr::wiforce::kernel {

namespace {

// Snapshots over which the level of the noise is learned: seven groups of the default
// length, .24 s. A receiver whose noise rises for good loses five groups of that length;
// with three groups in the window it would lose two, but read a stretch of loud
// interference of .15 s (and take it for a motion of the tag).
constexpr int WINDOW = 4096;
// Quantile over the groups of the window that is their level. Short groups that are hit
// as a whole are then rejected as long as they are fewer than three quarters.
constexpr double GROUP_QUANTILE = 0.25;

} // namespace

recent_level::recent_level(int group_length)
    : d_groups((WINDOW + group_length - 1) / group_length)
{
}

void recent_level::add(float value)
{
    d_values.push_back(value);
    if (d_values.size() > d_groups)
        d_values.pop_front();
    std::vector<float> values(d_values.begin(), d_values.end());
    d_level = quantile(values, GROUP_QUANTILE);
}

} // namespace gr::wiforce::kernel
