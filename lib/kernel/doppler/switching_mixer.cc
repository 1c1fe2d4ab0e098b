// SPDX-License-Identifier: GPL-3.0-or-later
#include "switching_mixer.h"

#include "../clones.h"
#include "../require.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

namespace gr::wiforce::kernel {

namespace {

// Columns that are summed at a time, in registers: of so many rows they fit into the
// cache, for all tags.
constexpr std::size_t width = 16, vectors = 4;
using four = double __attribute__((vector_size(32)));

int columns_of(const std::vector<double>& weights, const std::vector<double>& times_s)
{
    require(!times_s.empty() && weights.size() % times_s.size() == 0,
            "switching_mixer",
            "weights",
            "must have a row for each of " + std::to_string(times_s.size()) +
                " snapshots",
            weights.size());
    return weights.size() / times_s.size();
}

} // namespace

switching_mixer::switching_mixer(const std::vector<double>& weights,
                                 std::vector<double> times_s)
    : d_times_s(std::move(times_s)),
      d_columns(columns_of(weights, d_times_s)),
      d_sums((d_columns + width - 1) / width * width * d_times_s.size())
{
    const std::size_t snapshots = d_times_s.size(), columns = d_columns;
    for (std::size_t first = 0; first < columns; first += width) {
        double* sums = &d_sums[first * snapshots];
        for (std::size_t snapshot = 0; snapshot < snapshots; snapshot++, sums += width) {
            if (snapshot)
                std::copy_n(sums - width, width, sums);
            const double* const row = &weights[snapshot * columns];
            for (std::size_t i = 0; i < width && first + i < columns; i++)
                sums[i] += row[first + i];
        }
    }
}

std::vector<std::complex<double>> switching_mixer::mix(const clock* clocks,
                                                       const pulses* of,
                                                       std::size_t tags,
                                                       bool with_slopes) const
{
    const std::size_t tones = d_columns / 2, snapshots = d_times_s.size();
    std::vector<std::complex<double>> mixed(tones * 4 * tags);
    const std::unique_ptr<edge[]> edges(new edge[2 * tags * snapshots]);
    std::vector<std::size_t> count(2 * tags);
    std::vector<double> average(snapshots + 1), slope(snapshots + 1); // 0 at the end
    for (std::size_t i = 0; i < count.size(); i++) {
        averages(clocks[i / 2], of[i / 2], i % 2, average.data(), slope.data());
        count[i] = edges_of(average.data(), slope.data(), &edges[i * snapshots]);
    }
    double sums[2 * width];
    for (std::size_t first = 0; first < tones; first += width / 2)
        for (std::size_t i = 0; i < count.size(); i++) {
            add(&edges[i * snapshots],
                count[i],
                &d_sums[2 * first * snapshots],
                with_slopes,
                sums);
            auto* to = &mixed[4 * tags * first + i];
            for (std::size_t tone = 0; tone < std::min(width / 2, tones - first);
                 tone++, to += 4 * tags) {
                to[0] = { sums[2 * tone], sums[2 * tone + 1] };
                to[2 * tags] = { sums[width + 2 * tone], sums[width + 2 * tone + 1] };
            }
        }
    return mixed;
}

// Averages of a waveform over the snapshots, and their derivatives by the phase.
WIFORCE_CLONES
void switching_mixer::averages(
    const clock& at, const pulses& of, int waveform, double* average, double* slope) const
{
    // Both clocks' ramps are as steep: the second runs twice as fast and so does its
    // window.
    const double steep = -0.5 / at.half_window;
    const double times = (waveform ? 2 : 1) / (2 * M_PI);
    const double start = times * at.phase - (waveform ? 0.5 + of.delay / M_PI : 0),
                 rate = times * at.rate;
    const double half = at.half_window * times, scale = 0.5 / half,
                 reach = of.duty[waveform] / 2 + half;
    for (std::size_t i = 0; i < d_times_s.size(); i++) {
        const double cycles = start + rate * d_times_s[i];
        const double off = cycles - std::nearbyint(cycles); // from a pulse's centre
        // A window that is shorter than pulse and gap sees one edge at most: a ramp.
        const double ramp = (reach - std::abs(off)) * scale;
        average[i] = ramp < 0 ? 0 : ramp > 1 ? 1 : ramp;
        slope[i] = ramp < 0 || ramp > 1 ? 0 : off > 0 ? steep : -steep;
    }
}

std::size_t
switching_mixer::edges_of(const double* average, const double* slope, edge* found) const
{
    std::size_t count = 0;
    for (std::size_t i = 0; i < d_times_s.size(); i++) {
        const double less = average[i] - average[i + 1],
                     less_steep = slope[i] - slope[i + 1];
        found[count] = { i, less, less_steep };
        count += (less != 0) | (less_steep != 0);
    }
    return count;
}

// Sums of some columns over all snapshots, by parts.
WIFORCE_CLONES
void switching_mixer::add(const edge* edges,
                          std::size_t count,
                          const double* columns,
                          bool with_slopes,
                          double* sums) const
{
    four average[vectors]{}, slope[vectors]{};
    for (std::size_t i = 0; i < count; i++) {
        const double* const until = columns + edges[i].snapshot * width;
        for (std::size_t v = 0; v < vectors; v++) {
            four values;
            std::memcpy(&values, until + 4 * v, sizeof values);
            average[v] += edges[i].average * values;
            if (with_slopes)
                slope[v] += edges[i].slope * values;
        }
    }
    std::memcpy(sums, average, sizeof average);
    std::memcpy(sums + width, slope, sizeof slope);
}

} // namespace gr::wiforce::kernel
