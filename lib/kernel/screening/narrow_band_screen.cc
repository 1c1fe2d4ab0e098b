// SPDX-License-Identifier: GPL-3.0-or-later
#include "narrow_band_screen.h"

#include <algorithm>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

// Change of a snapshot against a neighbour, median over the subcarriers, up to which
// interference covers only a part of the band: a multiple of its typical value, of which
// it has a standard deviation of 18 % (a burst of 7 dB over the band multiplies it by 6),
// or of the mean over the subcarriers. That is .69 for noise, some .4 for a burst that
// fades over the band, and below .1 for a strong transmitter on 8 of 64.
constexpr float TYPICAL_MEDIAN = 2.5f;
constexpr float NARROW_MEDIAN = 0.2f;
// Snapshots without interference whose mean is the typical power of the subcarriers.
constexpr std::size_t LEAST_QUIET = 8;
// That mean where there are none, as a multiple of the typical median; 1.5 to 2.3 with a
// tag.
constexpr float MEAN_OF_TYPICAL = 2.0f;
// Quantile of that median over the snapshots of a group that is its typical value. Edges
// of two tags are beside seven snapshots of ten.
constexpr double BAND_QUANTILE = 0.15;

float mean_of(const std::vector<float>& powers)
{
    return std::accumulate(powers.begin(), powers.end(), 0.0f) / powers.size();
}

} // namespace

narrow_band_screen::narrow_band_screen(int group_length, int symbol_length)
    : d_length(group_length),
      d_width(symbol_length),
      d_typical_median(group_length),
      d_fourier(symbol_length),
      d_spectra(std::size_t(group_length) * symbol_length),
      d_pairs(group_length),
      d_changes(group_length),
      d_powers(symbol_length)
{
}

int narrow_band_screen::keep(const phase_group& group, std::vector<std::uint8_t>& marks)
{
    const float typical = measure_changes(group, marks);
    const float limit = TYPICAL_MEDIAN * typical; // an edge of a tag, or a band, is above
    const auto is_narrow = [&](int n) {
        if (n < 0 || n >= d_length || !marks[n] || !(d_changes[n].mean > 0))
            return false;
        const change& of = d_changes[n];
        return of.median < std::max(limit, NARROW_MEDIAN * of.mean);
    };
    d_narrow.clear();
    spectrum sums(d_width);
    float level = 0;
    std::size_t summed = 0, quiet = 0;
    for (int n = 0; n < d_length; n++) {
        // A single one may be a burst beside an edge of a fading tag, a single other one
        // between two narrow ones an edge.
        if (marks[n] && is_narrow(n - 1) + is_narrow(n) + is_narrow(n + 1) >= 2)
            d_narrow.push_back(n);
        if (!(d_changes[n].mean > 0) || d_changes[n].median > limit)
            continue;
        if (marks[n]) {
            measure_pair(d_changes[n].pair);
            for (int k = 0; k < d_width; k++)
                sums[k] += d_powers[k];
            summed++;
        } else {
            level += d_changes[n].mean;
            quiet++;
        }
    }
    if (summed == 0)
        return 0;
    level = quiet < LEAST_QUIET ? MEAN_OF_TYPICAL * typical : level / quiet;
    float kept = 0; // information, each subcarrier weighted by its own noise
    for (const float sum : sums) {
        const float excess = std::max(sum / (summed * level) - 1, 0.0f);
        kept += 1 / (1 + excess * d_narrow.size() / d_length) / d_width;
    }
    if (kept <= 1 - static_cast<float>(d_narrow.size()) / d_length)
        return 0;
    for (const int n : d_narrow)
        marks[n] = 0;
    return static_cast<int>(d_narrow.size());
}

// Changes of all snapshots; returns the typical median over the subcarriers, 0 where it
// is not known.
float narrow_band_screen::measure_changes(const phase_group& group,
                                          const std::vector<std::uint8_t>& marks)
{
    for (int n = 0; n < d_length; n++)
        if (group.mask()[n]) {
            std::copy_n(group.slot(n), d_width, d_fourier.input());
            std::copy_n(
                d_fourier.execute(), d_width, &d_spectra[std::size_t(n) * d_width]);
        }
    d_values.clear();
    for (int n = 0; n + 1 < d_length; n++)
        d_pairs[n] = group.mask()[n] && group.mask()[n + 1] ? measure_pair(n) : change{};
    for (int n = 0; n < d_length; n++) {
        d_changes[n] = change_of(n);
        if (!marks[n] && d_changes[n].mean > 0)
            d_values.push_back(d_changes[n].median);
    }
    if (d_values.size() >= LEAST_QUIET)
        d_typical_median.add(quantile(d_values, BAND_QUANTILE));
    return d_typical_median.value();
}

// Change from a snapshot to the next one, and its powers.
narrow_band_screen::change narrow_band_screen::measure_pair(int n)
{
    const fc32* const here = &d_spectra[std::size_t(n) * d_width];
    const fc32* const there = here + d_width;
    for (int k = 0; k < d_width; k++)
        d_powers[k] = std::norm(here[k] - there[k]);
    d_sorted = d_powers;
    return { ordered(d_sorted, d_width, d_width / 2), mean_of(d_powers), n };
}

// Change of a snapshot against that neighbour from which it differs less: an edge of a
// tag is beside one of them. 0 where there is no neighbour.
narrow_band_screen::change narrow_band_screen::change_of(int n) const
{
    const change before = n > 0 ? d_pairs[n - 1] : change{};
    const change after = n + 1 < d_length ? d_pairs[n] : change{};
    if (!(before.mean > 0))
        return after;
    return after.pair < 0 || after.median >= before.median ? before : after;
}

} // namespace gr::wiforce::kernel
