// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
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
    // the centre. Throws std::invalid_argument where the rows do not have equal lengths.
    switching_mixer(std::vector<double> weights, std::vector<double> times_s);

    // Length of a row.
    int columns() const { return d_columns; }

    // Sums of the rows, each times the averages of both waveforms over its snapshot: two
    // rows. Behind them two rows with the derivatives by the phase of the clock.
    void mix(const clock& at, const pulses& of, double* sums) const;

private:
    const std::vector<double> d_weights, d_times_s;
    const int d_columns;
};

} // namespace gr::wiforce::kernel
