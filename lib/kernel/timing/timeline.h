// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>

namespace gr::wiforce::kernel {

/*
 * Relates the items of a stream to the device's sample count, by times reported for some
 * of them.
 *
 * A time later than the items since the one before account for means lost samples. One
 * that is earlier, or later by more than LONGEST_GAP_S, is implausible and ignored. When
 * the next time follows on from the implausible one, or at most LONGEST_NEW_GAP_S later,
 * the device's clock was reset: a device reports times where it lost samples and hardly
 * elsewhere.
 */
class timeline
{
public:
    static constexpr double LONGEST_GAP_S = 3600;
    // Of a gap after a reset: two implausible times are rarely so close.
    static constexpr double LONGEST_NEW_GAP_S = 1;

    struct time {
        std::uint64_t seconds;
        double fraction; // seconds, 0 or more
    };
    enum class verdict {
        agrees,
        gap,     // `off` samples were lost just before the item
        ignored, // malformed, or `off` samples from what was expected
        restarts // the clock was reset; `off` samples were lost since its first time
    };
    struct judgement {
        timeline::verdict verdict;
        double off; // samples; NaN for a malformed time
    };

    // Throws std::invalid_argument unless sample_rate is positive and finite.
    explicit timeline(double sample_rate);

    // Takes the time of an item; items come in order.
    judgement note(std::uint64_t item, time time);

    // Samples lost so far, as the times say.
    std::uint64_t lost() const { return d_lost; }

    // Samples were lost or repeated since the last time, as the frames show: `lost`,
    // known modulo the frame length. The next time includes them.
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
    std::uint64_t d_lost = 0;
    std::optional<mark> d_last;
    std::optional<mark> d_implausible; // the next one decides
    std::uint64_t d_expected = 0;      // samples lost since d_last, ...
    std::uint64_t d_expected_most = 0; // or fewer by whole frames up to this
    std::uint64_t d_frame_length = 1;
};

} // namespace gr::wiforce::kernel
