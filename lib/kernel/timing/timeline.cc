// SPDX-License-Identifier: GPL-3.0-or-later
#include "timeline.h"

#include "../require.h"

#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

static constexpr double LARGEST_FRACTION_S = 1e9;

timeline::timeline(double sample_rate) : d_sample_rate(sample_rate)
{
    require(std::isfinite(sample_rate) && sample_rate > 0,
            "timeline: sample_rate must be positive",
            sample_rate);
}

// Samples by which a time is later than the items since another account for.
double timeline::lead(const mark& now, const mark& since) const
{
    const double seconds = static_cast<double>(static_cast<std::int64_t>(
                               now.time.seconds - since.time.seconds)) +
                           (now.time.fraction - since.time.fraction);
    return std::round(seconds * d_sample_rate -
                      static_cast<double>(now.item - since.item));
}

bool timeline::is_loss(double lead, double longest_s) const
{
    return lead >= 0 && lead <= longest_s * d_sample_rate;
}

void timeline::expect_loss(std::uint64_t lost, std::uint64_t frame_length)
{
    d_expected += lost;
    d_expected_most += frame_length;
    d_frame_length = frame_length;
}

// Samples lost before an item besides the expected ones; below 0 for a time that goes
// back.
double timeline::lost_before(const mark& now) const
{
    const double lost = lead(now, *d_last) - d_expected;
    const bool expected = lost < 0 && lost >= -static_cast<double>(d_expected_most) &&
                          std::fmod(lost, d_frame_length) == 0;
    return expected ? 0 : lost;
}

timeline::judgement timeline::note(std::uint64_t item, time time)
{
    if (!(time.fraction >= 0 && time.fraction < LARGEST_FRACTION_S))
        return { verdict::ignored, std::numeric_limits<double>::quiet_NaN() };
    const mark now{ item, time };
    const double lost = d_last ? lost_before(now) : 0;
    judgement judgement{ lost > 0 ? verdict::gap : verdict::agrees, lost };
    if (!is_loss(lost, LONGEST_GAP_S)) {
        // A loss that the frames showed since then lies before the implausible time.
        const double since_reset = d_implausible ? lead(now, *d_implausible) : -1;
        if (!is_loss(since_reset, LONGEST_NEW_GAP_S)) {
            d_implausible = now;
            return { verdict::ignored, lost };
        }
        judgement = { verdict::restarts, since_reset };
    }
    d_lost += static_cast<std::uint64_t>(judgement.off);
    d_last = now;
    d_implausible.reset();
    d_expected = d_expected_most = 0;
    return judgement;
}

std::optional<timeline::time> timeline::time_at(std::uint64_t item) const
{
    if (!d_last)
        return std::nullopt;
    const double fraction =
        d_last->time.fraction + static_cast<double>(item - d_last->item) / d_sample_rate;
    const double carried = std::floor(fraction);
    return time{ d_last->time.seconds + static_cast<std::uint64_t>(carried),
                 fraction - carried };
}

} // namespace gr::wiforce::kernel
