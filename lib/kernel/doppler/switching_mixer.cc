// SPDX-License-Identifier: GPL-3.0-or-later
#include "switching_mixer.h"

#include "../clones.h"
#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

inline void add_row(double factor, const double* row, int columns, double* __restrict sum)
{
    for (int i = 0; i < columns; i++)
        sum[i] += factor * row[i];
}

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

switching_mixer::switching_mixer(std::vector<double> weights, std::vector<double> times_s)
    : d_weights(std::move(weights)),
      d_times_s(std::move(times_s)),
      d_columns(columns_of(d_weights, d_times_s))
{
}

std::vector<std::complex<double>> switching_mixer::mix(const clock* clocks,
                                                       const pulses* of,
                                                       std::size_t tags,
                                                       bool with_slopes) const
{
    const std::size_t tones = d_columns / 2;
    std::vector<std::complex<double>> mixed(tones * 4 * tags);
    std::vector<double> sums(4 * d_columns);
    for (std::size_t tag = 0; tag < tags; tag++) {
        add(clocks[tag], of[tag], with_slopes, sums.data());
        for (std::size_t row = 0; row < 4; row++) {
            const double* const sum = &sums[row * d_columns];
            auto* to = &mixed[row / 2 * 2 * tags + 2 * tag + row % 2];
            for (std::size_t tone = 0; tone < tones; tone++, to += 4 * tags)
                *to = { sum[2 * tone], sum[2 * tone + 1] };
        }
    }
    return mixed;
}

WIFORCE_CLONES
void switching_mixer::add(const clock& at,
                          const pulses& of,
                          bool with_slopes,
                          double* sums) const
{
    std::fill_n(sums, 4 * d_columns, 0.0);
    // Both clocks' ramps are as steep: the second runs twice as fast and so does its
    // window.
    const double slope = -0.5 / at.half_window;
    for (std::size_t snapshot = 0; snapshot < d_times_s.size(); snapshot++) {
        const double* const row = &d_weights[snapshot * d_columns];
        const double first = (at.phase + at.rate * d_times_s[snapshot]) / (2 * M_PI);
        const double second = 2 * first - 0.5 - of.delay / M_PI;
        for (int waveform = 0; waveform < 2; waveform++) {
            double cycles = waveform ? second : first; // from the nearest pulse's centre
            cycles -= std::nearbyint(cycles);
            const double half = at.half_window * (waveform ? 1 / M_PI : 0.5 / M_PI);
            // A window that is shorter than pulse and gap sees one edge at most: a ramp.
            const double average =
                (of.duty[waveform] / 2 + half - std::abs(cycles)) * (0.5 / half);
            if (average <= 0)
                continue;
            double* const sum = sums + waveform * d_columns;
            add_row(std::min(average, 1.0), row, d_columns, sum);
            if (average < 1 && with_slopes)
                add_row(cycles > 0 ? slope : -slope, row, d_columns, sum + 2 * d_columns);
        }
    }
}

} // namespace gr::wiforce::kernel
