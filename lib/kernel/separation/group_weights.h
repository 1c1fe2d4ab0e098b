// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

// The M tones of a group lie at opposite frequencies, and their weights are conjugates:
// each pair is a + jb and a - jb. These parts a and b (M x K, pair by pair from the
// lowest frequency) have real weights, hence noise of a real covariance and a real
// response to the tags' waveforms, which costs half to a quarter of the arithmetic.
template <class T> // float or double
void parts_of(const std::complex<T>* tones,
              std::size_t count,
              std::size_t subcarriers,
              complex* parts);

// The pair that one of the M tones belongs to, and the sign of its second part.
inline std::pair<std::size_t, int> pair_of(std::size_t row, std::size_t count)
{
    return row >= count / 2 ? std::pair{ row - count / 2, 1 }
                            : std::pair{ count / 2 - 1 - row, -1 };
}

// One of the M tones, row of K, from the parts.
void tone_of(const complex* parts,
             std::size_t row,
             std::size_t count,
             std::size_t subcarriers,
             complex* tone);

// Makes the noise of parts (M x `columns` of double or complex) white by a lower
// triangular matrix (M x M).
template <class T>
void whiten(const double* whitener,
            const T* parts,
            std::size_t count,
            std::size_t columns,
            T* white);

// A tag's clock at the centre of a group: phase in rad, rate in rad/s, and half the phase
// that a snapshot averages over.
struct switching_clock {
    double phase, rate, half_window;
};

// A tag's pulses: delay of clock 2 in rad of clock 1, duty cycles of both.
// signal/switching.py describes the waveforms.
struct switching_pulses {
    double delay;
    std::array<double, 2> duty;
};

// Weights that lead from the snapshots received of a group to its M tones.
class group_weights
{
public:
    // `mixer`: of parts, a row of M for each snapshot; `times_s`: of the snapshots, from
    // the centre. `whitener`: lower triangular, M x M, makes the noise of parts white.
    // `loss`: snapshots of a group over those received.
    group_weights(const std::vector<double>& mixer,
                  std::vector<double> times_s,
                  std::vector<double> whitener,
                  double loss);

    const double loss;

    std::size_t tones() const { return d_tones; }
    std::size_t width() const { return d_width; } // of rows of M, as registers hold

    // What the switching waveforms of S tags leave in the parts: both waveforms of each
    // tag, averaged over the snapshots, and behind these their derivatives by the phase
    // of the clock, M x 4S.
    std::vector<double> switched(const switching_clock* clocks,
                                 const switching_pulses* of,
                                 std::size_t tags) const;

    // What each sample of a symbol leaves in the parts, through one of a tag's two
    // switches, more than the sample before: N x M, in rows of `width()`. The first row
    // holds only edges within that sample: the level before it is not known here.
    // `repetitions` of the symbol are averaged.
    std::vector<double> steps(const switching_clock& at,
                              const switching_pulses& of,
                              int waveform,
                              std::size_t length,
                              int repetitions) const;

    const std::vector<double>& whitener() const { return d_whitener; }

private:
    void averages(const switching_clock& at,
                  const switching_pulses& of,
                  int waveform,
                  double* average,
                  double* slope) const;
    void add_mixed(const std::vector<double>& first,
                   const std::vector<double>& second,
                   double* first_sums,
                   double* second_sums) const;

    const std::size_t d_tones, d_width; // the latter a multiple of 8
    const std::vector<double> d_times_s, d_whitener;
    // Sums of the mixer's rows from each snapshot to the last, and a row of zeros:
    // waveforms change at few snapshots.
    std::vector<double> d_sums_to_end;
};

} // namespace gr::wiforce::kernel
