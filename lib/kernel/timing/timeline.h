// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>

namespace gr::wiforce::kernel {

/*
 * Where the items of a stream lie on the device's count of samples, by times given for
 * some of them.
 *
 * A time later than the items since the one before account for means lost samples. One
 * that is earlier, or later by more than LONGEST_GAP_S, is a slip of the device or of the
 * way here: it is ignored. When the next one does not go on from before the slip but from
 * the slip itself, or at most LONGEST_NEW_GAP_S later, the device's clock was set anew: a
 * device gives times where it lost samples, and hardly elsewhere.
 */
class timeline
{
public:
    static constexpr double LONGEST_GAP_S = 3600;
    // Of a gap on a clock set anew: two slips lie rarely so close.
    static constexpr double LONGEST_NEW_GAP_S = 1;

    struct time {
        std::uint64_t seconds;
        double fraction; // seconds, 0 or more
    };
    enum class verdict {
        agrees,
        gap,     // `off` samples were lost just before the item
        ignored, // no time, or `off` samples beside what it should be
        restarts // the clock was set anew; `off` samples were lost since its first time
    };
    struct judgement {
        timeline::verdict verdict;
        double off; // samples; NaN for what is no time
    };

    // Throws std::invalid_argument unless sample_rate is positive and finite.
    explicit timeline(double sample_rate);

    // Takes the time of an item; items come in order.
    judgement note(std::uint64_t item, time time);

    // Frames show that samples were lost since the last time, or came twice: `lost`, but
    // for whole frames. The next time tells how many.
    void expect_loss(std::uint64_t lost, std::uint64_t frame_length);

    // Time of an item at or after the last that had one; empty before any.
    std::optional<time> time_at(std::uint64_t item) const;

private:
    struct mark {
        std::uint64_t item;
        timeline::time time;
    };

    double lead(const mark& now, const mark& since) const;
    double lost_before(const mark& now) const;
    bool is_loss(double lead, double longest_s) const;

    const double d_sample_rate;
    std::optional<mark> d_last;
    std::optional<mark> d_doubtful;    // the next decides
    std::uint64_t d_expected = 0;      // samples lost since d_last, ...
    std::uint64_t d_expected_most = 0; // or fewer by whole frames up to this
    std::uint64_t d_frame_length = 1;
};

} // namespace gr::wiforce::kernel
