// SPDX-License-Identifier: GPL-3.0-or-later
#include "tone_accumulator.h"

#include "../fold/sample_loops.h"
#include "../require.h"

#include <algorithm>
#include <cmath>
#include <functional>

namespace gr::wiforce::kernel {

namespace {

using row = const std::complex<double>*;

// A step of float: the weights are multiplied in float, and may have been stored so.
constexpr double SAME = 2e-7;

double largest(row w, int length)
{
    double value = 0;
    for (int n = 0; n < length; n++)
        value = std::max(value, std::abs(w[n]));
    return value;
}

bool is_real(row w, int length, double limit)
{
    return std::all_of(
        w, w + length, [&](auto v) { return std::abs(v.imag()) <= limit; });
}

bool are_conjugates(row a, row b, int length, double limit)
{
    for (int n = 0; n < length; n++)
        if (std::abs(a[n] - std::conj(b[n])) > limit)
            return false;
    return true;
}

} // namespace

tone_accumulator::tone_accumulator(const std::vector<std::complex<double>>& weights,
                                   int group_length,
                                   int symbol_length)
    : d_length(group_length), d_width(2 * symbol_length), d_table(weights)
{
    const char* where = "phase_group_doppler";
    require(group_length >= 1, where, "group_length", "must be >= 1", group_length);
    require(!weights.empty() && weights.size() % group_length == 0,
            where,
            "weights",
            "must hold one or more rows of group_length = " +
                std::to_string(group_length),
            std::to_string(weights.size()) + " values");
    for (const auto& w : weights)
        require(std::isfinite(w.real()) && std::isfinite(w.imag()),
                where,
                "weights",
                "must be finite",
                w);
    lay_out_rows();
}

void tone_accumulator::lay_out_rows()
{
    const int tones = d_table.size() / d_length;
    const auto table_row = [&](int m) {
        return d_table.data() + std::size_t(m) * d_length;
    };
    std::vector<std::function<double(std::complex<double>)>> parts; // of a real row
    std::vector<int> origins;
    const auto add_row = [&](int m, bool imaginary) {
        origins.push_back(m);
        parts.push_back(imaginary ? [](std::complex<double> v) { return v.imag(); }
                                  : [](std::complex<double> v) { return v.real(); });
        return static_cast<int>(origins.size()) - 1;
    };
    for (int m = 0; m < tones; m++) {
        const double limit = SAME * largest(table_row(m), d_length);
        int partner = 0;
        while (partner < m &&
               !are_conjugates(table_row(m), table_row(partner), d_length, limit))
            partner++;
        if (partner < m)
            d_tones.push_back({ d_tones[partner].real,
                                d_tones[partner].imaginary,
                                -d_tones[partner].sign });
        else if (is_real(table_row(m), d_length, limit))
            d_tones.push_back({ add_row(m, false), -1, 1 });
        else {
            const int real = add_row(m, false);
            d_tones.push_back({ real, add_row(m, true), 1 });
        }
        std::complex<double> sum = 0;
        for (int n = 0; n < d_length; n++)
            sum += table_row(m)[n];
        d_weight_sums.push_back(sum);
    }
    d_real_rows = origins.size();
    d_padded_rows = (d_real_rows + ROW_BLOCK - 1) / ROW_BLOCK * ROW_BLOCK;
    d_weights.assign(std::size_t(d_length) * d_padded_rows, 0.0f);
    for (int r = 0; r < d_real_rows; r++)
        for (int n = 0; n < d_length; n++)
            d_weights[std::size_t(n) * d_padded_rows + r] =
                static_cast<float>(parts[r](table_row(origins[r])[n]));
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
        std::complex<double> weight = d_weight_sums[m];
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
