// SPDX-License-Identifier: GPL-3.0-or-later
#include "input_events.h"

#include "tag_values.h"

#include <algorithm>
#include <utility>

namespace gr::wiforce {

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
    : d_logger(std::move(logger)), d_timeline(sample_rate), d_settings(sample_rate)
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
        d_next = event{ tag.offset, 0, d_settings.usable(), true };
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
        d_next =
            event{ tag.offset, static_cast<std::uint64_t>(off), d_settings.usable() };
}

void input_events::note_setting(const gr::tag_t& tag)
{
    if (!pmt::is_real(tag.value) && !pmt::is_integer(tag.value))
        return;
    const double value = pmt::to_double(tag.value);
    const bool is_rate = pmt::eq(tag.key, keys::rx_rate);
    const bool was_usable = d_settings.usable();
    if (is_rate)
        d_settings.note_rate(value);
    else
        d_settings.note_carrier(value);
    if (d_settings.usable() == was_usable)
        return;
    if (was_usable)
        d_logger->warn("{} is {:g}, not {:g}; samples are discarded until it is set back",
                       pmt::symbol_to_string(tag.key),
                       value,
                       is_rate ? d_settings.sample_rate() : d_settings.carrier());
    d_next = event{ tag.offset, 0, d_settings.usable() };
}

} // namespace gr::wiforce
