// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_weights.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

template <class T>
WIFORCE_CLONES void parts_of(const std::complex<T>* tones,
                             std::size_t count,
                             std::size_t subcarriers,
                             complex* parts)
{
    const auto* const from = reinterpret_cast<const T*>(tones);
    auto* const to = reinterpret_cast<double*>(parts);
    const std::size_t row = 2 * subcarriers;
    for (std::size_t pair = 0; pair < count / 2; pair++) {
        const T* const upper = from + (count / 2 + pair) * row;
        const T* const lower = from + (count / 2 - 1 - pair) * row;
        double* const first = to + 2 * pair * row;
        double* const second = first + row;
        for (std::size_t i = 0; i < row; i++)
            first[i] = (double(upper[i]) + lower[i]) / 2;
        for (std::size_t i = 0; i < row; i += 2) {
            second[i] = (double(upper[i + 1]) - lower[i + 1]) / 2;
            second[i + 1] = (double(lower[i]) - upper[i]) / 2;
        }
    }
}

template void parts_of(const std::complex<float>*, std::size_t, std::size_t, complex*);
template void parts_of(const complex*, std::size_t, std::size_t, complex*);

WIFORCE_CLONES
void tone_of(const complex* parts,
             std::size_t row,
             std::size_t count,
             std::size_t subcarriers,
             complex* tone)
{
    const auto [pair, sign] = pair_of(row, count);
    const auto* const first = parts + 2 * pair * subcarriers;
    const auto* const second = first + subcarriers;
    for (std::size_t k = 0; k < subcarriers; k++)
        tone[k] = { first[k].real() - sign * second[k].imag(),
                    first[k].imag() + sign * second[k].real() };
}

template <class T>
WIFORCE_CLONES void whiten(const double* whitener,
                           const T* parts,
                           std::size_t count,
                           std::size_t columns,
                           T* white)
{
    std::fill_n(white, count * columns, 0.0);
    add_product({ whitener, count, count, count, 1, 1, true }, parts, columns, white);
}

template void whiten(const double*, const double*, std::size_t, std::size_t, double*);
template void whiten(const double*, const complex*, std::size_t, std::size_t, complex*);

group_weights::group_weights(const std::vector<double>& mixer,
                             std::vector<double> times_s,
                             std::vector<double> whitener,
                             double loss)
    : loss(loss),
      d_tones(mixer.size() / times_s.size()),
      d_width((d_tones + 7) / 8 * 8),
      d_times_s(std::move(times_s)),
      d_whitener(std::move(whitener)),
      d_sums_to_end((d_times_s.size() + 1) * d_width)
{
    for (std::size_t i = d_times_s.size(); i-- > 0;)
        for (std::size_t tone = 0; tone < d_tones; tone++)
            d_sums_to_end[i * d_width + tone] =
                d_sums_to_end[(i + 1) * d_width + tone] + mixer[i * d_tones + tone];
}

std::vector<double> group_weights::switched(const switching_clock* clocks,
                                            const switching_pulses* of,
                                            std::size_t tags) const
{
    const std::size_t lists = 2 * tags;
    std::vector<double> average(d_times_s.size()), slope(average.size());
    std::vector<double> sums(2 * lists * d_width), mixed(2 * lists * d_tones);
    for (std::size_t i = 0; i < lists; i++) {
        averages(clocks[i / 2], of[i / 2], i % 2, average.data(), slope.data());
        add_mixed(average, slope, &sums[i * d_width], &sums[(lists + i) * d_width]);
    }
    for (std::size_t i = 0; i < mixed.size(); i++)
        mixed[i] = sums[i % (2 * lists) * d_width + i / (2 * lists)];
    return mixed;
}

// Adds to sums (M) what two courses, which change at the same snapshots, leave in the
// parts.
WIFORCE_CLONES
void group_weights::add_mixed(const std::vector<double>& first,
                              const std::vector<double>& second,
                              double* first_sums,
                              double* second_sums) const
{
    constexpr std::size_t at_once = 4; // for which sums are loaded and stored
    std::vector<std::size_t> changed(first.size());
    std::size_t count = 1; // the first from 0
    for (std::size_t i = 1; i < first.size(); i++) {
        changed[count] = i;
        count += (first[i] != first[i - 1]) | (second[i] != second[i - 1]);
    }
    const double* rows[at_once];
    double by[at_once], also[at_once];
    for (std::size_t from = 0; from < count; from += at_once) {
        for (std::size_t j = 0; j < at_once; j++) {
            const bool is_change = from + j < count;
            const std::size_t i = is_change ? changed[from + j] : 0;
            const auto change_of = [=](const std::vector<double>& course) {
                return is_change ? course[i] - (i ? course[i - 1] : 0) : 0;
            };
            rows[j] = &d_sums_to_end[i * d_width];
            by[j] = change_of(first);
            also[j] = change_of(second);
        }
        for (std::size_t tone = 0; tone < d_width; tone++) {
            const double values[] = {
                rows[0][tone], rows[1][tone], rows[2][tone], rows[3][tone]
            };
            first_sums[tone] += (by[0] * values[0] + by[1] * values[1]) +
                                (by[2] * values[2] + by[3] * values[3]);
            second_sums[tone] += (also[0] * values[0] + also[1] * values[1]) +
                                 (also[2] * values[2] + also[3] * values[3]);
        }
    }
}

// Averages of a waveform over the snapshots, and their derivatives by the phase.
WIFORCE_CLONES
void group_weights::averages(const switching_clock& at,
                             const switching_pulses& of,
                             int waveform,
                             double* average,
                             double* slope) const
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

WIFORCE_CLONES
std::vector<double> group_weights::steps(const switching_clock& at,
                                         const switching_pulses& of,
                                         int waveform,
                                         std::size_t length,
                                         int repetitions) const
{
    const std::size_t snapshots = d_times_s.size();
    std::vector<double> steps(length * d_width), average(snapshots), slope(snapshots);
    averages(at, of, waveform, average.data(), slope.data());
    for (std::size_t i = 0; i < snapshots; i++) {
        if (slope[i] == 0)
            continue;
        // A pulse that begins in the window, where the average rises with the phase, is
        // on behind its edge, one that ends before it.
        const double edge = slope[i] > 0 ? 1 - average[i] : average[i];
        // Samples from the start of the repetition that holds the edge.
        const double sample = std::fmod(edge * repetitions * length, length);
        const auto first = std::min(static_cast<std::size_t>(sample), length - 1);
        const double late = sample - first,
                     step = (slope[i] > 0 ? 1.0 : -1.0) / repetitions;
        const double *const from = &d_sums_to_end[i * d_width], *const next =
                                                                    from + d_width;
        double* const to = &steps[first * d_width];
        // An edge within a sample leaves the mean over it; behind the last one nothing
        // follows.
        for (std::size_t tone = 0; tone < d_width; tone++)
            to[tone] += step * (1 - late) * (from[tone] - next[tone]);
        if (first + 1 < length)
            for (std::size_t tone = 0; tone < d_width; tone++)
                to[d_width + tone] += step * late * (from[tone] - next[tone]);
    }
    return steps;
}

} // namespace gr::wiforce::kernel
