// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/timing/timeline.h"
#include "kernel/types.h"
#include <gnuradio/logger.h>
#include <gnuradio/tags.h>

#include <atomic>
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
    void expect_carrier(double frequency_hz) { d_expected = frequency_hz; }

    // The rate and the carrier that tags report, 0 where they are as expected; for any
    // thread.
    double refused_rate() const { return d_refused_rate; }
    double refused_carrier() const { return d_refused_carrier; }

    // Values of rx_time that were malformed or implausible.
    std::uint64_t times_ignored() const { return d_times_ignored; }

private:
    bool usable() const { return d_rate_is_right && d_carrier_is_right; }
    void note(const gr::tag_t& tag);
    void note_time(const gr::tag_t& tag);
    void note_setting(const gr::tag_t& tag);

    const double d_sample_rate;
    const gr::logger_ptr d_logger;
    std::deque<gr::tag_t> d_tags; // not examined yet
    kernel::timeline d_timeline;
    bool d_rate_is_right = true;
    bool d_carrier_is_right = true;
    std::optional<double> d_expected; // carrier
    std::optional<double> d_carrier;  // the first one reported that is close to it
    std::atomic<double> d_refused_rate = 0, d_refused_carrier = 0;
    std::optional<event> d_next;
    kernel::counter d_times_ignored;
};

} // namespace gr::wiforce
