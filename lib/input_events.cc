// SPDX-License-Identifier: GPL-3.0-or-later
#include "input_events.h"

#include "tag_values.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gr::wiforce {

namespace {

// A carrier given within this fraction of a sensor model's is taken for it.
constexpr double CARRIER_TOLERANCE = 1e-3;

} // namespace

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

input_events::input_events(double sample_rate, gr::logger_ptr logger)
    : d_sample_rate(sample_rate), d_logger(std::move(logger)), d_timeline(sample_rate)
{
}

void input_events::add(std::vector<gr::tag_t> tags)
{
    std::stable_sort(tags.begin(), tags.end(), gr::tag_t::offset_compare);
    d_tags.insert(d_tags.end(), tags.begin(), tags.end());
}

const std::optional<input_events::event>& input_events::next(std::uint64_t before)
{
    for (; !d_next && !d_tags.empty() && d_tags.front().offset < before;
         d_tags.pop_front())
        note(d_tags.front());
    return d_next;
}

void input_events::note(const gr::tag_t& tag)
{
    if (pmt::eq(tag.key, keys::rx_time))
        note_time(tag);
    else if (pmt::eq(tag.key, keys::rx_rate) || pmt::eq(tag.key, keys::rx_freq))
        note_setting(tag);
    else if (pmt::eq(tag.key, keys::retuned))
        d_next = event{ tag.offset, 0, usable(), true };
}

void input_events::note_time(const gr::tag_t& tag)
{
    const auto time = rx_time_value(tag.value);
    if (!time) {
        d_logger->warn(
            "ignored an rx_time that is not (uint64 seconds, double fraction)");
        d_times_ignored += 1;
        return;
    }
    using kind = kernel::timeline::verdict;
    const auto [verdict, off] = d_timeline.note(tag.offset, *time);
    if (verdict == kind::ignored) {
        d_logger->warn("ignored an implausible rx_time: it is off by {:g} samples", off);
        d_times_ignored += 1;
        return;
    }
    if (verdict == kind::restarts)
        d_logger->warn("device clock was reset; rx_time is a new time reference");
    if (off > 0)
        d_next = event{ tag.offset, static_cast<std::uint64_t>(off), usable() };
}

void input_events::note_setting(const gr::tag_t& tag)
{
    if (!pmt::is_real(tag.value) && !pmt::is_integer(tag.value))
        return;
    const double value = pmt::to_double(tag.value);
    const bool was_usable = usable();
    if (pmt::eq(tag.key, keys::rx_rate)) {
        d_rate_is_right = std::abs(value - d_sample_rate) <= 1e-6 * d_sample_rate;
        d_refused_rate = d_rate_is_right ? 0 : value;
    } else if (!d_carrier && d_expected &&
               !(std::abs(value - *d_expected) <= CARRIER_TOLERANCE * *d_expected)) {
        d_carrier_is_right = false;
    } else {
        d_carrier = d_carrier.value_or(value);
        d_carrier_is_right = std::abs(value - *d_carrier) <= 1;
    }
    if (pmt::eq(tag.key, keys::rx_freq))
        d_refused_carrier = d_carrier_is_right ? 0 : value;
    if (usable() == was_usable)
        return;
    if (!usable())
        d_logger->warn("{} is {:g}, not {:g}; samples are discarded until it is set back",
                       pmt::symbol_to_string(tag.key),
                       value,
                       d_rate_is_right ? d_carrier.value_or(d_expected.value_or(0.0))
                                       : d_sample_rate);
    d_next = event{ tag.offset, 0, usable() };
}

} // namespace gr::wiforce
