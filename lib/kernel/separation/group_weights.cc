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

WIFORCE_CLONES
double whiten(const double* whitener,
              const complex* parts,
              std::size_t count,
              std::size_t subcarriers,
              complex* white)
{
    triangular_product(whitener, count, parts, subcarriers, white);
    return power_of(white, count * subcarriers) /
           double(std::max<std::size_t>(count * subcarriers, 1));
}

group_weights::group_weights(const std::vector<double>& mixer,
                             std::vector<double> times_s,
                             std::vector<double> whitener,
                             double loss)
    : loss(loss),
      d_tones(mixer.size() / times_s.size()),
      d_width((d_tones + 3) / 4 * 4),
      d_times_s(std::move(times_s)),
      d_whitener(std::move(whitener)),
      d_mixer(d_times_s.size() * d_width)
{
    for (std::size_t i = 0; i < d_times_s.size(); i++)
        std::copy_n(&mixer[i * d_tones], d_tones, &d_mixer[i * d_width]);
}

WIFORCE_CLONES
std::vector<double> group_weights::switched(const switching_clock* clocks,
                                            const switching_pulses* of,
                                            std::size_t tags) const
{
    const std::size_t snapshots = d_times_s.size(), lists = 2 * tags;
    std::vector<double> waveforms(2 * lists * snapshots), sums(2 * lists * d_width),
        mixed(2 * lists * d_tones);
    for (std::size_t i = 0; i < lists; i++)
        averages(clocks[i / 2],
                 of[i / 2],
                 i % 2,
                 &waveforms[i * snapshots],
                 &waveforms[(lists + i) * snapshots]);
    add_product(
        { waveforms.data(), 2 * lists, snapshots }, d_mixer.data(), d_width, sums.data());
    for (std::size_t i = 0; i < mixed.size(); i++)
        mixed[i] = sums[i % (2 * lists) * d_width + i / (2 * lists)];
    return mixed;
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
std::vector<double> group_weights::courses(const switching_clock* clocks,
                                           const switching_pulses* of,
                                           std::size_t tags,
                                           const double* mixing,
                                           std::size_t length,
                                           int repetitions) const
{
    const std::size_t snapshots = d_times_s.size(), ends = 2 * tags, row = ends * d_tones;
    std::vector<double> courses(length * row), average(snapshots), slope(snapshots);
    for (std::size_t end = 0; end < ends; end++) {
        const auto& at = clocks[end / 2];
        averages(at, of[end / 2], end % 2, average.data(), slope.data());
        for (std::size_t i = 0; i < snapshots; i++) {
            if (slope[i] == 0)
                continue;
            // A pulse that begins in the window, where the average rises with the phase,
            // is on behind its edge, one that ends before it.
            const double edge = slope[i] > 0 ? 1 - average[i] : average[i];
            // Samples from the start of the repetition that holds the edge.
            const double sample = std::fmod(edge * repetitions * length, length);
            const auto first = std::min(static_cast<std::size_t>(sample), length - 1);
            const double late = sample - first,
                         step = (slope[i] > 0 ? 1.0 : -1.0) / repetitions;
            const double* const from = &d_mixer[i * d_width];
            double* const to = &courses[first * row + end * d_tones];
            // An edge within a sample leaves the mean over it; behind the last one
            // nothing follows.
            for (std::size_t tone = 0; tone < d_tones; tone++)
                to[tone] += step * (1 - late) * from[tone];
            if (first + 1 < length)
                for (std::size_t tone = 0; tone < d_tones; tone++)
                    to[row + tone] += step * late * from[tone];
        }
    }
    std::vector<double> offset(row);
    for (std::size_t n = 0; n < length; n++)
        for (std::size_t i = 0; i < row; i++) {
            if (n)
                courses[n * row + i] += courses[(n - 1) * row + i];
            offset[i] -= courses[n * row + i] / length;
        }
    for (std::size_t end = 0; end < ends; end++)
        for (std::size_t tone = 0; tone < d_tones; tone++)
            offset[end * d_tones + tone] += mixing[tone * ends + end];
    for (std::size_t n = 0; n < length; n++)
        for (std::size_t i = 0; i < row; i++)
            courses[n * row + i] += offset[i];
    return courses;
}

const std::vector<double>& group_weights::colorer() const
{
    const std::size_t n = tones();
    if (!d_colorer.empty() || !n)
        return d_colorer;
    // Row by row from those above: each is what the row of the whitener leaves of 1.
    d_colorer.resize(n * n);
    for (std::size_t row = 0; row < n; row++) {
        auto* const found = &d_colorer[row * n];
        found[row] = 1.0;
        for (std::size_t above = 0; above < row; above++)
            for (std::size_t column = 0; column <= above; column++)
                found[column] -=
                    d_whitener[row * n + above] * d_colorer[above * n + column];
        for (std::size_t column = 0; column <= row; column++)
            found[column] /= d_whitener[row * n + row];
    }
    return d_colorer;
}

template <class T>
WIFORCE_CLONES void
color(const group_weights& weights, const T* white, std::size_t columns, T* parts)
{
    triangular_product(weights.colorer().data(), weights.tones(), white, columns, parts);
}

template void color(const group_weights&, const double*, std::size_t, double*);
template void color(const group_weights&, const complex*, std::size_t, complex*);

} // namespace gr::wiforce::kernel
