// SPDX-License-Identifier: GPL-3.0-or-later
#include "doppler_transform.h"

#include "../fold/sample_loops.h"
#include "../require.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// A step of float: the weights are multiplied in float, and may have been stored so.
constexpr double SAME = 2e-7;

bool are_conjugates(const complex* a, const complex* b, int length, double limit)
{
    return std::equal(a, a + length, b, [=](complex value, complex other) {
        return std::abs(value - std::conj(other)) <= limit;
    });
}

} // namespace

doppler_spectrum::doppler_spectrum(int group_length)
    : d_fft(require_group_length(group_length))
{
}

// As in tone_accumulator, differences from the first snapshot are transformed and that
// snapshot is added back, so that a static path does not round into the other bins.
void doppler_spectrum::transform(const phase_group& group, fc32* out)
{
    const int length = rows();
    const float scale = 1.0f / length;
    const fc32* reference = group.reference();
    const int width = group.symbol_length();
    for (int k = 0; k < width; k++) {
        for (int n = 0; n < length; n++)
            d_fft.input()[n] = group.slot(n)[k] - reference[k];
        const fc32* spectrum = d_fft.execute();
        for (int m = 0; m < length; m++)
            out[std::size_t(m) * width + k] = scale * spectrum[m];
    }
    for (int n = 0; n < length; n++)
        d_fft.input()[n] = group.mask()[n];
    const fc32* mask = d_fft.execute();
    for (int m = 0; m < length; m++) {
        // A complete group's mask is constant: exactly zero outside bin 0.
        const fc32 weight =
            group.is_complete() ? fc32(m == 0 ? 1.0f : 0.0f) : scale * mask[m];
        for (int k = 0; k < width; k++)
            out[std::size_t(m) * width + k] += weight * reference[k];
    }
}

tone_accumulator::tone_accumulator(const std::vector<complex>& weights,
                                   int group_length,
                                   int symbol_length)
    : d_length(require_group_length(group_length)),
      d_width(2 * symbol_length),
      d_table(weights)
{
    require(!weights.empty() && weights.size() % group_length == 0,
            "phase_group_doppler: weights must hold one or more rows of group_length = " +
                std::to_string(group_length),
            std::to_string(weights.size()) + " values");
    require_finite(weights, "phase_group_doppler: weights");
    std::vector<std::pair<const complex*, bool>> parts; // of a row, imaginary or real
    for (int m = 0; m < int(weights.size()) / d_length; m++) {
        const auto row = [&](int tone) { return &d_table[std::size_t(tone) * d_length]; };
        const complex *const first = row(m), *const end = first + d_length;
        double limit = 0;
        for (const complex* value = first; value < end; value++)
            limit = std::max(limit, SAME * std::abs(*value));
        int partner = 0;
        while (partner < m && !are_conjugates(first, row(partner), d_length, limit))
            partner++;
        const bool is_real = are_conjugates(first, first, d_length, 2 * limit);
        const int next = parts.size();
        if (partner < m) {
            d_tones.push_back(d_tones[partner]);
            d_tones.back().sign *= -1;
        } else {
            d_tones.push_back({ next, is_real ? -1 : next + 1, 1 });
            parts.push_back({ first, false });
            if (!is_real)
                parts.push_back({ first, true });
        }
        d_weight_sums.push_back(std::accumulate(first, end, complex()));
    }
    const int real_rows = parts.size(); // sums taken over the snapshots
    d_padded_rows = (real_rows + ROW_BLOCK - 1) / ROW_BLOCK * ROW_BLOCK;
    d_weights.assign(std::size_t(d_length) * d_padded_rows, 0.0f);
    for (int r = 0; r < real_rows; r++)
        for (int n = 0; n < d_length; n++) {
            const auto [from, imaginary] = parts[r];
            d_weights[std::size_t(n) * d_padded_rows + r] =
                imaginary ? from[n].imag() : from[n].real();
        }
    d_sums.resize(std::size_t(d_padded_rows) * d_width);
}

void tone_accumulator::transform(const phase_group& group, fc32* tones)
{
    std::vector<int> absent;
    for (int n = 0; n < d_length && !group.is_complete(); n++)
        if (!group.mask()[n])
            absent.push_back(n);
    transform(group.slot(0), group.reference(), absent, tones);
}

void tone_accumulator::transform(const fc32* snapshots,
                                 const fc32* reference,
                                 const std::vector<int>& absent,
                                 fc32* tones)
{
    std::fill(d_sums.begin(), d_sums.end(), 0.0f);
    const auto* const values = reinterpret_cast<const float*>(snapshots);
    for (int first = 0; first < d_length; first += BLOCK)
        accumulate({ values + std::size_t(first) * d_width,
                     reinterpret_cast<const float*>(reference),
                     &d_weights[std::size_t(first) * d_padded_rows],
                     std::min(BLOCK, d_length - first),
                     d_padded_rows,
                     d_width },
                   d_sums.data());
    // Real arithmetic: the complex product of the library looks for infinities.
    const std::vector<float> none(d_width, 0.0f);
    for (int m = 0; m < rows(); m++) {
        const tone& t = d_tones[m];
        complex weight = d_weight_sums[m];
        for (const int n : absent)
            weight -= d_table[std::size_t(m) * d_length + n];
        const float* a = &d_sums[std::size_t(t.real) * d_width];
        const float* b =
            t.imaginary < 0 ? none.data() : &d_sums[std::size_t(t.imaginary) * d_width];
        const double re = weight.real(), im = weight.imag(), sign = t.sign;
        fc32* out = tones + std::size_t(m) * d_width / 2;
        for (int k = 0; k < d_width / 2; k++) {
            const double x = reference[k].real(), y = reference[k].imag();
            // (a_re + j a_im) + j sign (b_re + j b_im) + (re + j im) (x + j y)
            out[k] = fc32(a[2 * k] - sign * b[2 * k + 1] + (re * x - im * y),
                          a[2 * k + 1] + sign * b[2 * k] + (re * y + im * x));
        }
    }
}

} // namespace gr::wiforce::kernel
