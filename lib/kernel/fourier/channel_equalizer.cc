// SPDX-License-Identifier: GPL-3.0-or-later
#include "channel_equalizer.h"

#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

using table = std::vector<std::complex<double>>;

constexpr const char* WHERE = "ofdm_channel_estimator";

int checked_rows(int rows)
{
    require(rows >= 1, WHERE, "rows", "must be >= 1", rows);
    return rows;
}

std::size_t checked_length(const table& factors)
{
    require(factors.size() >= SHORTEST_SYMBOL && factors.size() <= LONGEST_SYMBOL,
            WHERE,
            "factors",
            "must hold 16 to 4096 values",
            std::to_string(factors.size()) + " values");
    return factors.size();
}

std::vector<fc32>
checked_table(const char* parameter, const table& values, std::size_t length)
{
    require(values.size() == length,
            WHERE,
            parameter,
            "must hold " + std::to_string(length) + " values",
            std::to_string(values.size()) + " values");
    for (const auto& value : values)
        require(std::isfinite(value.real()) && std::isfinite(value.imag()),
                WHERE,
                parameter,
                "must be finite",
                value);
    return { values.begin(), values.end() };
}

// Written out: the operator of std::complex tests for NaN and infinity.
void multiply(const fc32* x, const fc32* y, int count, fc32* product)
{
    for (int k = 0; k < count; k++) {
        const float a = x[k].real(), b = x[k].imag();
        const float c = y[k].real(), d = y[k].imag();
        product[k] = fc32(a * c - b * d, a * d + b * c);
    }
}

const std::vector<int>& checked_bins(const std::vector<int>& bins, int symbol_length)
{
    for (const int bin : bins)
        require(bin >= 0 && bin < symbol_length,
                "tone_reader",
                "bins",
                "must be 0 to " + std::to_string(symbol_length - 1),
                bin);
    return bins;
}

} // namespace

channel_equalizer::channel_equalizer(const table& factors,
                                     int rows,
                                     const table& rotation)
    : d_rows(checked_rows(rows)),
      d_factors(checked_table("factors", factors, checked_length(factors))),
      d_rotation(
          rotation.empty()
              ? std::vector<fc32>()
              : checked_table("rotation", rotation, std::size_t(rows) * factors.size())),
      d_fft(symbol_length())
{
}

void channel_equalizer::equalize(int row, const fc32* samples, fc32* channel)
{
    if (d_rotation.empty())
        std::copy_n(samples, symbol_length(), d_fft.input());
    else
        multiply(samples,
                 &d_rotation[std::size_t(row) * symbol_length()],
                 symbol_length(),
                 d_fft.input());
    multiply(d_fft.execute(), d_factors.data(), symbol_length(), channel);
}

tone_channel::tone_channel(const std::vector<std::complex<double>>& factors,
                           int rows,
                           const std::vector<std::complex<double>>& rotation,
                           const std::vector<int>& bins)
    : d_equalizer(factors, rows, rotation), d_bins(checked_bins(bins, symbol_length()))
{
}

void tone_channel::write(fc32* transform, fc32* tones)
{
    for (int row = 0; row < d_equalizer.rows(); row++) {
        fc32* const channel = transform + std::size_t(row) * symbol_length();
        d_equalizer.equalize(row, channel, channel);
        for (const int bin : d_bins)
            *tones++ = channel[bin];
    }
}

} // namespace gr::wiforce::kernel
