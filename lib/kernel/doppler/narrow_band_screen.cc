// SPDX-License-Identifier: GPL-3.0-or-later
#include "narrow_band_screen.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

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

} // namespace

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
