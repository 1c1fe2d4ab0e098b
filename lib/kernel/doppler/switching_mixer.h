// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// What the switching waveforms of a tag leave in the tones of a group: sums over the
// snapshots of a group. signal/switching.py describes the waveforms.
class switching_mixer
{
public:
    // A clock at the centre of a group: phase in rad, rate in rad/s, and half the phase
    // that a snapshot averages over.
    struct clock {
        double phase, rate, half_window;
    };

    // Delay of clock 2 in rad of clock 1, duty cycles of both.
    struct pulses {
        double delay;
        std::array<double, 2> duty;
    };

    // `weights` has a row of equal length for each snapshot, `times_s` their times from
    // the centre.
    switching_mixer(const std::vector<double>& weights, std::vector<double> times_s);

    // Length of a row.
    int columns() const { return d_columns; }

    // Rows are those of the M parts of tones. Their response to the averages of both
    // waveforms of S tags over each snapshot, and behind these to their derivatives by
    // the phase of the clock, which are 0 unless they are asked for: M x 4S.
    std::vector<double> mix(const clock* clocks,
                            const pulses* of,
                            std::size_t tags,
                            bool with_slopes = true) const;

private:
    // A snapshot, and by how much less the average over the next one is, and its slope.
    struct edge {
        std::size_t snapshot;
        double average, slope;
    };

    void averages(const clock& at,
                  const pulses& of,
                  int waveform,
                  double* average,
                  double* slope) const;
    static edge* edges_of(const double* average,
                          const double* slope,
                          std::size_t first,
                          std::size_t last,
                          edge* found);
    static void add(const edge* edges,
                    const edge* end,
                    const double* columns,
                    bool with_slopes,
                    double* sums);

    const std::vector<double> d_times_s;
    const int d_columns;
    std::vector<double> d_sums; // of the rows up to each snapshot, by groups of columns
};

} // namespace gr::wiforce::kernel
