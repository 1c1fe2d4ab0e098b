// SPDX-License-Identifier: GPL-3.0-or-later
#include "interference_screen.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// Quantiles over the snapshots of a group: the level, two whose ratio is the spread, and
// one that is noise even where many tags leave an edge in most snapshots.
constexpr double LEVEL = 0.20, LOW = 0.10, HIGH = 0.25, FLOOR = 0.03;
// Smallest difference above the level at which a snapshot is rejected. An edge of a
// tag leaves the smaller of two differences, about twice the smallest of three. Noise has
// a standard deviation of 15 to 20 % (of 128 smallest values;
// with fewer the spread is larger, and with it the limit), so that this is some seven
// of them, and a burst 10 dB above the noise exceeds it by seven more.
constexpr float SMALLEST_LIMIT = 5.0f;
// The same of the largest difference, with a standard deviation of 8 %.
constexpr float LARGEST_LIMIT = 2.2f;
// Where the differences spread more (phase noise of separate oscillators under a strong
// static path), so does the limit: of a normal distribution, nine standard deviations are
// 16 times the distance from LOW to HIGH above LEVEL.
constexpr float SPREADS = 16.0f;
// Noise, and interference over the whole frame, has a ratio of smallest to largest of .11
// +- .02. Edges of two tags in one snapshot leave a single difference, five times the
// smallest of three, but raise the largest more; so does a tag that changes within
// microseconds when a press makes or breaks contact.
constexpr float LEAST_RATIO = 0.065f;
// Ratio of their levels below which noise is below the converter's steps: a few samples
// change by a step, the smallest difference is zero or anything, and the largest counts.
constexpr float COARSE_RATIO = 0.08f;
// Spread of the smallest difference from which this is the reason: .06 for noise, more
// where fewer than some ten samples change. Otherwise the largest difference is raised by
// filters that ring at the edges of the preamble below a strong static path.
constexpr float COARSE_SPREAD = 0.1f;
// Ratio of the levels of noise, by which the smallest difference says what the largest
// would be without edges.
constexpr float NOISE_RATIO = 0.11f;
// Share of the coincidences of three edges that raise the smallest difference as far as
// interference does (a third to a half with four to eight tags), and standard deviations
// of their number.
constexpr double RAISING = 0.5;
constexpr double EDGE_MARGIN = 3.0;
// Differences between snapshots that are compared for the level of the tags, how far
// apart at most, and the quantile that counts. Tags are in different states in six pairs
// of ten, two tags both in the states farthest apart in three of a hundred. A snapshot
// that was hit in one repetition of four shows a sixteenth of that in its mean.
constexpr int PAIRS = 128;
constexpr int FARTHEST = 61;
constexpr double TAG_QUANTILE = 0.97;
constexpr float TAG_MARGIN = 3.0f;
// Where so many of the pairs differ by a level, that quantile reaches it.
constexpr int REACHING = PAIRS - static_cast<int>(TAG_QUANTILE * (PAIRS - 1));
// Values above it, as a multiple of the group's HIGH, are left out of the next group's
// quantiles before they are sorted.
constexpr float BEYOND_HIGH = 1.04f;

// Highest noise that is no interference.
float limit_of(const noise_statistics& of, float limit)
{
    const float amplitude = 1 + SPREADS * of.spread;
    return of.level * std::max(limit, amplitude * amplitude);
}

float smallest_limit(const noise_statistics& smallest, const noise_statistics& largest)
{
    const float ratio = largest.floor > 0 ? smallest.level / largest.floor : 0;
    const bool few = !(smallest.level > 0) || smallest.spread > COARSE_SPREAD;
    if (ratio < COARSE_RATIO && few)
        return limit_of(largest, LARGEST_LIMIT);
    return limit_of(smallest, SMALLEST_LIMIT);
}

// Largest difference that noise has at most, by the smallest one of most snapshots. Where
// that is below the converter's steps it says nothing.
float edge_limit(const noise_statistics& smallest, const noise_statistics& largest)
{
    const float level = std::max(smallest.level / NOISE_RATIO, largest.floor);
    return limit_of({ level, level, smallest.spread }, LARGEST_LIMIT);
}

constexpr float LARGEST = std::numeric_limits<float>::max();
constexpr float BEYOND = std::numeric_limits<float>::infinity();

bool is_known(const snapshot_noise& noise)
{
    return (noise.smallest >= 0) & (noise.largest > 0) & (noise.largest <= LARGEST);
}

// |a - b|^2, in sums that the processor takes side by side.
float squared_distance(const fc32* a, const fc32* b, int count)
{
    constexpr int SUMS = 16;
    const float* const x = reinterpret_cast<const float*>(a);
    const float* const y = reinterpret_cast<const float*>(b);
    float sums[SUMS] = {};
    int n = 0;
    for (; n + SUMS <= 2 * count; n += SUMS)
        for (int i = 0; i < SUMS; i++)
            sums[i] += (x[n + i] - y[n + i]) * (x[n + i] - y[n + i]);
    float sum = 0;
    for (; n < 2 * count; n++)
        sum += (x[n] - y[n]) * (x[n] - y[n]);
    for (const float part : sums)
        sum += part;
    return sum;
}

} // namespace

interference_screen::interference_screen(int group_length, int symbol_length)
    : d_length(group_length),
      d_smallest_limit(group_length),
      d_largest_limit(group_length),
      d_edge_share(group_length),
      d_marks(group_length),
      d_narrow_band(group_length, symbol_length)
{
}

const std::vector<std::uint8_t>& interference_screen::examine(const phase_group& group)
{
    std::fill(d_marks.begin(), d_marks.end(), 0);
    d_rejected = 0;
    learn(group);
    if (!d_smallest_limit.is_known())
        return d_marks;
    const bool whole = mark_whole(group);
    const bool beyond = mark_beyond_tags(group);
    if (whole || beyond) {
        mark_neighbours(group);
        d_rejected -= d_narrow_band.keep(group, d_marks);
    }
    return d_marks;
}

// Of the snapshots with noise; `high` is a guess of HIGH, and becomes it.
noise_statistics interference_screen::statistics_of(const phase_group& group,
                                                    float snapshot_noise::*member,
                                                    std::size_t known,
                                                    float& high)
{
    const auto index = [&](double part) -> std::size_t { return part * (known - 1); };
    const auto collect = [&](float most) {
        d_values.resize(d_length + 1);
        for (int n = 0; n < d_length; n++) {
            const snapshot_noise& noise = group.noise_of(n);
            d_values[n] = (group.mask()[n] & is_known(noise)) ? noise.*member : BEYOND;
        }
        std::size_t count = 0;
        for (int n = 0; n < d_length; n++) {
            const float value = d_values[n];
            d_values[count] = value;
            count += value <= most;
        }
        d_values.resize(count);
    };
    collect(BEYOND_HIGH * high);
    if (d_values.size() <= index(HIGH))
        collect(LARGEST);
    high = ordered(d_values, d_values.size(), index(HIGH));
    const float level = ordered(d_values, index(HIGH) + 1, index(LEVEL));
    const float low = ordered(d_values, index(LEVEL) + 1, index(LOW));
    const float floor = ordered(d_values, index(LOW) + 1, index(FLOOR));
    const float spread = std::sqrt(high) - std::sqrt(low);
    return { floor, level, level > 0 ? spread / std::sqrt(level) : 0.0f };
}

void interference_screen::learn(const phase_group& group)
{
    const std::size_t known = count_if(group, is_known);
    if (known == 0)
        return;
    const noise_statistics largest =
        statistics_of(group, &snapshot_noise::largest, known, d_high.largest);
    const noise_statistics smallest =
        statistics_of(group, &snapshot_noise::smallest, known, d_high.smallest);
    d_largest_limit.add(limit_of(largest, LARGEST_LIMIT));
    d_smallest_limit.add(smallest_limit(smallest, largest));
    const float limit = edge_limit(smallest, largest);
    const float edges = count_if(
        group, [&](const snapshot_noise& noise) { return noise.largest > limit; });
    d_edge_share.add(edges / known);
}

template <class Condition>
int interference_screen::count_if(const phase_group& group,
                                  const Condition& condition) const
{
    int count = 0;
    for (int n = 0; n < d_length; n++)
        count += group.mask()[n] & condition(group.noise_of(n));
    return count;
}

void interference_screen::mark(int n)
{
    d_marks[n] = 1;
    d_rejected++;
}

bool interference_screen::mark_whole(const phase_group& group)
{
    float limit = d_smallest_limit.value();
    const auto is_hit = [&](const snapshot_noise& noise) {
        // A single difference (both are the same) shows every edge.
        return (noise.smallest > limit) & (noise.smallest > LEAST_RATIO * noise.largest) &
               (noise.smallest < noise.largest);
    };
    const int hits = count_if(group, is_hit);
    if (hits > 0 && hits <= edges_in_all_differences(group))
        limit = std::max(limit, tag_level(group));
    for (int n = 0; hits > 0 && n < d_length; n++)
        if (group.mask()[n] && is_hit(group.noise_of(n)))
            mark(n);
    return d_rejected > 0;
}

// Most snapshots of the group in which edges of several tags raise all three differences,
// an edge being in each of them independently.
double interference_screen::edges_in_all_differences(const phase_group& group) const
{
    const double in_one = 1 - std::cbrt(1 - d_edge_share.value());
    const double expected = RAISING * std::pow(in_one, 3) * group.present();
    return expected + EDGE_MARGIN * std::sqrt(expected);
}

bool interference_screen::mark_beyond_tags(const phase_group& group)
{
    const auto is_beyond = [&](int n, float limit) {
        return group.mask()[n] && !d_marks[n] && group.noise_of(n).largest > limit;
    };
    float most = d_largest_limit.value();
    for (int n = 0; n < d_length; n++)
        if (is_beyond(n, most))
            most = group.noise_of(n).largest;
    if (!(most > d_largest_limit.value()))
        return false;
    const float limit =
        std::max(d_largest_limit.value(), TAG_MARGIN * tag_level(group, most));
    if (!(most > limit))
        return false;
    for (int n = 0; n < d_length; n++)
        if (is_beyond(n, limit))
            mark(n);
    return true;
}

void interference_screen::mark_neighbours(const phase_group& group)
{
    d_slots.clear();
    for (int n = 0; n < d_length; n++) {
        const bool beside =
            (n > 0 && d_marks[n - 1]) || (n + 1 < d_length && d_marks[n + 1]);
        if (group.mask()[n] && !d_marks[n] && beside &&
            group.noise_of(n).largest > d_largest_limit.value())
            d_slots.push_back(n);
    }
    for (const int n : d_slots)
        mark(n);
}

// Half the squared difference of two states of the tags, mean over the samples: what an
// edge between them adds to the largest difference. Where it explains `noise`, any level
// that does.
float interference_screen::tag_level(const phase_group& group, float noise)
{
    d_slots.clear();
    for (int n = 0; n < d_length; n++)
        if (group.mask()[n] && !d_marks[n])
            d_slots.push_back(n);
    d_values.clear();
    const std::size_t count = d_slots.size();
    int reaching = 0;
    for (std::size_t i = 0; i < PAIRS; i++) {
        // Many distances: at a single one the clocks might always be in the same state.
        const std::size_t first = i * count / PAIRS;
        const fc32* a = group.slot(d_slots[first]);
        const fc32* b = group.slot(d_slots[(first + 1 + i * 37 % FARTHEST) % count]);
        d_values.push_back(squared_distance(a, b, group.symbol_length()) /
                           (2 * group.symbol_length()));
        reaching += TAG_MARGIN * d_values.back() >= noise;
        if (reaching == REACHING)
            return d_values.back();
    }
    return quantile(d_values, TAG_QUANTILE);
}

} // namespace gr::wiforce::kernel
