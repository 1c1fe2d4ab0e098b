// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/timing/device_settings.h"
#include "kernel/timing/timeline.h"
#include "kernel/types.h"
#include <gnuradio/logger.h>
#include <gnuradio/tags.h>

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

namespace gr::wiforce {

// What changes on a stream of samples, according to the device's tags rx_time, rx_rate
// and rx_freq, and to the tag retuned.
class input_events
{
public:
    struct event {
        std::uint64_t item;
        std::uint64_t lost;   // samples before it
        bool usable;          // whether rate and carrier are as configured from here on
        bool retuned = false; // the oscillators have new phases from here on
    };

    input_events(double sample_rate, gr::logger_ptr logger);

    // Forgets tags and events that were not taken up.
    void forget()
    {
        d_tags.clear();
        d_next.reset();
    }
    // Takes the tags of further items, in any order.
    void add(std::vector<gr::tag_t> tags);
    // The next event before an item, if any; the same one until it is dropped.
    const std::optional<event>& next(std::uint64_t before);
    void drop() { d_next.reset(); }

    // See timeline::expect_loss.
    void expect_loss(std::uint64_t lost, std::uint64_t frame_length)
    {
        d_timeline.expect_loss(lost, frame_length);
    }

    // The carrier that the first rx_freq must be close to.
    void expect_carrier(double frequency_hz) { d_settings.expect_carrier(frequency_hz); }

    // For any thread.
    const kernel::device_settings& settings() const { return d_settings; }

    // Values of rx_time that were malformed or implausible.
    std::uint64_t times_ignored() const { return d_times_ignored; }

private:
    void note(const gr::tag_t& tag);
    void note_time(const gr::tag_t& tag);
    void note_setting(const gr::tag_t& tag);

    const gr::logger_ptr d_logger;
    std::deque<gr::tag_t> d_tags; // not examined yet
    kernel::timeline d_timeline;
    kernel::device_settings d_settings;
    std::optional<event> d_next;
    kernel::counter d_times_ignored;
};

} // namespace gr::wiforce
