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

// Change of a snapshot against a neighbour, median over the subcarriers, up to which
// interference covers only a part of the band: a multiple of its typical value, of which
// it has a standard deviation of 18 % (a burst of 7 dB over the band multiplies it by 6),
// or of the mean over the subcarriers. That is .69 for noise, some .4 for a burst that
// fades over the band, and below .1 for a strong transmitter on 8 of 64.
constexpr float TYPICAL_MEDIAN = 2.5f;
constexpr float NARROW_MEDIAN = 0.2f;
// Snapshots without interference that are compared with their neighbours: the quantile
// below is known to 18 % from each group's, and the limit is 2.5 times as high.
constexpr std::size_t QUIET = 8;
// That mean where there are none, as a multiple of the typical median; 1.5 to 2.3 with a
// tag.
constexpr float MEAN_OF_TYPICAL = 2.0f;
// Quantile of that median over the snapshots of a group that is its typical value. Edges
// of two tags are beside seven snapshots of ten.
constexpr double BAND_QUANTILE = 0.15;

// Snapshots over which the level of the noise is learned: seven groups of the default
// length, .24 s. A receiver whose noise rises for good loses five groups of that length;
// with three groups in the window it would lose two, but read a stretch of loud
// interference of .15 s (and take it for a motion of the tag).
constexpr int WINDOW = 4096;
// Quantile over the groups of the window that is their level. Short groups that are hit
// as a whole are then rejected as long as they are fewer than three quarters.
constexpr double GROUP_QUANTILE = 0.25;
// Values among which a quantile is found, and divisions of them.
constexpr std::size_t FEW = 16;
constexpr int ROUNDS = 12;

// The value at `index` of the sorted values, which are sorted in part; it lies among the
// first `candidates`: a call for a lower one is faster after one for a higher one.
float ordered(std::vector<float>& values, std::size_t candidates, std::size_t index)
{
    // std::nth_element guesses the outcome of comparisons that nobody can guess. Values
    // are divided here without a branch, until few are left.
    std::size_t first = 0, last = candidates;
    for (int round = 0; round < ROUNDS && last - first > FEW; round++) {
        const float a = values[first], b = values[(first + last) / 2];
        const float c = values[last - 1];
        const float pivot = std::max(std::min(a, b), std::min(std::max(a, b), c));
        std::size_t below = first;
        for (std::size_t n = first; n < last; n++) {
            const float value = values[n];
            values[n] = values[below];
            values[below] = value;
            below += value < pivot;
        }
        (index < below ? last : first) = below;
    }
    const auto at = values.begin() + index;
    std::nth_element(values.begin() + first, at, values.begin() + last);
    return *at;
}

// Quantile `part` of values, which are sorted in part.
float quantile(std::vector<float>& values, double part)
{
    return ordered(values, values.size(), part * (values.size() - 1));
}

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

recent_level::recent_level(int group_length)
    : d_groups((WINDOW + group_length - 1) / group_length)
{
}

void recent_level::add(float value)
{
    d_values.push_back(value);
    if (d_values.size() > d_groups)
        d_values.pop_front();
    std::vector<float> values(d_values.begin(), d_values.end());
    d_level = quantile(values, GROUP_QUANTILE);
}

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

narrow_band_screen::narrow_band_screen(int group_length, int symbol_length)
    : d_length(group_length),
      d_width(symbol_length),
      d_typical_median(group_length),
      d_fourier(symbol_length),
      d_pairs(group_length)
{
}

int narrow_band_screen::keep(const phase_group& group, std::vector<std::uint8_t>& marks)
{
    for (change& of : d_pairs)
        of.powers.clear();
    learn_quiet(group, marks);
    const float typical = d_typical_median.value();
    const float limit = TYPICAL_MEDIAN * typical; // an edge of a tag, or a band, is above
    d_is_narrow.assign(d_length + 2, 0);          // with one more at each end
    for (int n = 0; n < d_length; n++)
        d_is_narrow[n + 1] = marks[n] && is_narrow(group, n, limit);
    // A single one may be a burst beside an edge of a fading tag, a single other one
    // between two narrow ones an edge.
    d_slots.clear();
    for (int n = 0; n < d_length; n++)
        if (marks[n] && d_is_narrow[n] + d_is_narrow[n + 1] + d_is_narrow[n + 2] >= 2)
            d_slots.push_back(n);
    if (d_slots.empty())
        return 0;

    d_values.assign(d_width, 0.0f); // powers where interference may be narrow
    std::size_t summed = 0, quiet = 0;
    for (int n = 0; n < d_length; n++) {
        const change* const of = marks[n] ? measured_change(group, n) : nullptr;
        if (!of || of->median > limit)
            continue;
        for (int k = 0; k < d_width; k++)
            d_values[k] += of->powers[k];
        summed++;
    }
    if (summed == 0)
        return 0;
    float level = 0;
    for (const change* of : d_quiet)
        if (of->median <= limit) {
            level += of->mean;
            quiet++;
        }
    level = quiet > 0 ? level / quiet : MEAN_OF_TYPICAL * typical;
    const float share = static_cast<float>(d_slots.size()) / d_length;
    float kept = 0; // information, each subcarrier weighted by its own noise
    for (const float sum : d_values) {
        const float excess = std::max(sum / (summed * level) - 1, 0.0f);
        kept += 1 / (1 + excess * share) / d_width;
    }
    if (kept <= 1 - share)
        return 0;
    for (const int n : d_slots)
        marks[n] = 0;
    return static_cast<int>(d_slots.size());
}

void narrow_band_screen::learn_quiet(const phase_group& group,
                                     const std::vector<std::uint8_t>& marks)
{
    d_slots.clear();
    for (int n = 0; n < d_length; n++)
        if (group.mask()[n] && !marks[n])
            d_slots.push_back(n);
    d_quiet.clear();
    d_values.clear();
    const std::size_t count = std::min(d_slots.size(), QUIET);
    for (std::size_t i = 0; i < count; i++) {
        const int n = d_slots[i * d_slots.size() / count];
        if (const change* const of = measured_change(group, n)) {
            d_quiet.push_back(of);
            d_values.push_back(of->median);
        }
    }
    if (d_values.size() >= QUIET)
        d_typical_median.add(quantile(d_values, BAND_QUANTILE));
}

// Whether the median of a snapshot's change is below the limit, or low against the mean.
bool narrow_band_screen::is_narrow(const phase_group& group, int n, float limit)
{
    const auto limit_of = [&](const change& of) {
        return std::max(limit, NARROW_MEDIAN * of.mean);
    };
    // It is not where both changes are above: counting takes less time than a median.
    const auto may_be = [&](const change* of) {
        if (!of)
            return false;
        const float highest = limit_of(*of);
        int below = 0;
        for (const float power : of->powers)
            below += power < highest;
        return below > d_width / 2;
    };
    if (!may_be(measured_pair(group, n - 1)) && !may_be(measured_pair(group, n)))
        return false;
    const change* const of = measured_change(group, n);
    return of->median < limit_of(*of);
}

// Change of a snapshot against that neighbour from which it differs less: an edge of a
// tag is beside one of them. None where there is no neighbour.
const narrow_band_screen::change*
narrow_band_screen::measured_change(const phase_group& group, int n)
{
    change* nearest = nullptr;
    for (const int first : { n - 1, n }) {
        change* const of = measured_pair(group, first);
        if (!of)
            continue;
        if (of->median < 0) {
            d_sorted = of->powers;
            of->median = ordered(d_sorted, d_width, d_width / 2);
        }
        if (!nearest || of->median < nearest->median)
            nearest = of;
    }
    return nearest;
}

// Change from a snapshot to the next one; none where one of them is absent, or both are
// the same.
narrow_band_screen::change* narrow_band_screen::measured_pair(const phase_group& group,
                                                              int n)
{
    if (n < 0 || n + 1 >= d_length || !group.mask()[n] || !group.mask()[n + 1])
        return nullptr;
    change& of = d_pairs[n];
    if (of.powers.empty()) {
        const fc32 *const here = group.slot(n), *const there = group.slot(n + 1);
        fc32* const difference = d_fourier.input();
        for (int i = 0; i < d_width; i++)
            difference[i] = here[i] - there[i];
        const fc32* const spectrum = d_fourier.execute();
        of.powers.resize(d_width);
        float sum = 0;
        for (int k = 0; k < d_width; k++) {
            of.powers[k] = std::norm(spectrum[k]);
            sum += of.powers[k];
        }
        of.mean = sum / d_width;
        of.median = -1;
    }
    return of.mean > 0 ? &of : nullptr;
}

} // namespace gr::wiforce::kernel
