// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace gr::wiforce::kernel {

// Force is hidden where a phase error of 1 deg, or of the reading's own size if that is
// larger, costs this much,
constexpr double hidden_n = 0.5;
// and knowing the location would cut that by this factor.
constexpr double hidden_ratio = 2.5;

} // namespace gr::wiforce::kernel
