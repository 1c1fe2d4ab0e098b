// SPDX-License-Identifier: GPL-3.0-or-later
#include "switching_mixer.h"

#include "../clones.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

namespace gr::wiforce::kernel {

namespace {

// Columns that are summed at a time, in registers, and snapshots of which they fit into
// the smallest cache (16 kB), for all tags.
using four = double __attribute__((vector_size(32)));
constexpr std::size_t width = 16, vectors = width * sizeof(double) / sizeof(four),
                      stretch = 128;

} // namespace

switching_mixer::switching_mixer(const std::vector<double>& weights,
                                 std::vector<double> times_s)
    : d_times_s(std::move(times_s)),
      d_columns(d_times_s.empty() ? 0 : weights.size() / d_times_s.size()),
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

std::vector<double> switching_mixer::mix(const clock* clocks,
                                         const pulses* of,
                                         std::size_t tags,
                                         bool with_slopes) const
{
    const std::size_t parts = d_columns, snapshots = d_times_s.size();
    std::vector<double> mixed(parts * 4 * tags);
    const std::size_t lists = 2 * tags;
    const std::unique_ptr<edge[]> edges(new edge[lists * snapshots]);
    std::vector<edge*> ends{ edges.get() }; // of each list in each stretch of snapshots
    std::vector<double> average(lists * (snapshots + 1)), slope(average.size());
    for (std::size_t i = 0; i < lists; i++)
        averages(clocks[i / 2],
                 of[i / 2],
                 i % 2,
                 &average[i * (snapshots + 1)], // and 0 after the last one
                 &slope[i * (snapshots + 1)]);
    for (std::size_t from = 0; from < snapshots; from += stretch)
        for (std::size_t i = 0; i < lists; i++)
            ends.push_back(edges_of(&average[i * (snapshots + 1)],
                                    &slope[i * (snapshots + 1)],
                                    from,
                                    std::min(from + stretch, snapshots),
                                    ends.back()));
    std::vector<double> sums(2 * width * lists);
    for (std::size_t first = 0; first < parts; first += width) {
        std::fill(sums.begin(), sums.end(), 0.0);
        for (std::size_t i = 0; i + 1 < ends.size(); i++)
            add(ends[i],
                ends[i + 1],
                &d_sums[first * snapshots],
                with_slopes,
                &sums[i % lists * 2 * width]);
        for (std::size_t part = 0; part < std::min(width, parts - first); part++) {
            auto* const to = &mixed[(first + part) * 2 * lists];
            for (std::size_t i = 0; i < lists; i++) {
                to[i] = sums[2 * width * i + part];
                to[lists + i] = sums[width * (2 * i + 1) + part];
            }
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

// Of some snapshots; gives the end of what was found.
switching_mixer::edge* switching_mixer::edges_of(const double* average,
                                                 const double* slope,
                                                 std::size_t first,
                                                 std::size_t last,
                                                 edge* found)
{
    for (std::size_t i = first; i < last; i++) {
        const double less = average[i] - average[i + 1],
                     less_steep = slope[i] - slope[i + 1];
        *found = { i, less, less_steep };
        found += less * less + less_steep * less_steep > 0; // without a branch
    }
    return found;
}

// Adds to the sums of some columns over all snapshots, by parts.
WIFORCE_CLONES
void switching_mixer::add(const edge* edges,
                          const edge* end,
                          const double* columns,
                          bool with_slopes,
                          double* sums)
{
    four average[vectors], slope[vectors];
    std::memcpy(average, sums, sizeof average);
    std::memcpy(slope, sums + width, sizeof slope);
    for (; edges != end; edges++) {
        const double* const until = columns + edges->snapshot * width;
        for (std::size_t i = 0; i < vectors; i++) {
            four values;
            std::memcpy(&values, until + 4 * i, sizeof values);
            average[i] += edges->average * values;
            if (with_slopes)
                slope[i] += edges->slope * values;
        }
    }
    std::memcpy(sums, average, sizeof average);
    std::memcpy(sums + width, slope, sizeof slope);
}

} // namespace gr::wiforce::kernel
