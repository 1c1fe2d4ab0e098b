// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/fold/frame_walk.h"
#include "kernel/timing/timeline.h"
#include "kernel/types.h"
#include <gnuradio/tags.h>
#include <gnuradio/wiforce/api.h>
#include <gnuradio/wiforce/names.h>
#include <pmt/pmt.h>

#include <cstdint>
#include <optional>
#include <vector>

namespace gr::wiforce {

// Keys of stream tags.
namespace keys {

inline const pmt::pmt_t rx_time = pmt::mp(names::RX_TIME);
inline const pmt::pmt_t rx_rate = pmt::mp(names::RX_RATE);
inline const pmt::pmt_t rx_freq = pmt::mp(names::RX_FREQ);
inline const pmt::pmt_t snapshot = pmt::mp(names::SNAPSHOT);
inline const pmt::pmt_t noise = pmt::mp(names::NOISE);
inline const pmt::pmt_t group = pmt::mp(names::GROUP);
inline const pmt::pmt_t mask = pmt::mp(names::MASK);
inline const pmt::pmt_t disturbed = pmt::mp(names::DISTURBED);
inline const pmt::pmt_t saturated = pmt::mp(names::SATURATED);
inline const pmt::pmt_t retuned = pmt::mp(names::RETUNED);
inline const pmt::pmt_t slipped = pmt::mp(names::SLIPPED);

} // namespace keys

// The time in the value of an rx_time tag, a tuple(uint64 seconds, double fraction) as
// gr-uhd makes it; nothing when it is anything else. Python blocks use the same rule.
WIFORCE_API std::optional<kernel::timeline::time> rx_time_value(const pmt::pmt_t& value);

// Index in the value of a tag `snapshot`; nothing when it is anything else.
inline std::optional<std::uint64_t> snapshot_index(const pmt::pmt_t& value)
{
    if (!pmt::is_uint64(value) && !(pmt::is_integer(value) && pmt::to_long(value) >= 0))
        return std::nullopt;
    return pmt::to_uint64(value);
}

// Value of the tag `noise`: two floats for the tagged folded vector and each of those
// that follow, the members of snapshot_noise. A tag per vector would cost more than the
// fold.
inline pmt::pmt_t noise_value(const kernel::snapshot_noise* noise, int count)
{
    return pmt::init_f32vector(2 * count, reinterpret_cast<const float*>(noise));
}

// Value of the tag `slipped`: the frames before a slip that may lie elsewhere.
inline pmt::pmt_t slip_value(const kernel::frame_range& misplaced)
{
    return pmt::init_u64vector(2, { misplaced.first, misplaced.second });
}

// The same of one or more slips, in a value of a tag.
inline bool is_slip_value(const pmt::pmt_t& value)
{
    return pmt::is_u64vector(value) && pmt::length(value) % 2 == 0;
}

} // namespace gr::wiforce
