// SPDX-License-Identifier: GPL-3.0-or-later
#include "channel_equalizer.h"

#include "../require.h"

#include <algorithm>

namespace gr::wiforce::kernel {

namespace {

// Written out: the operator of std::complex tests for NaN and infinity.
void multiply(const fc32* x, const fc32* y, int count, fc32* product)
{
    for (int k = 0; k < count; k++) {
        const float a = x[k].real(), b = x[k].imag();
        const float c = y[k].real(), d = y[k].imag();
        product[k] = fc32(a * c - b * d, a * d + b * c);
    }
}

// Checks parameters before anything is made of them; gives the symbol's length.
int checked_length(const std::vector<complex>& factors,
                   int rows,
                   const std::vector<complex>& rotation,
                   const std::vector<int>& bins)
{
    const std::string where = "ofdm_channel_estimator: ";
    const std::size_t values = std::max(rows, 0) * factors.size();
    const int length = static_cast<int>(factors.size());
    require(rows >= 1, where + "rows must be >= 1", rows);
    require(factors.size() >= SHORTEST_SYMBOL && factors.size() <= LONGEST_SYMBOL,
            where + "factors must hold 16 to 4096 values",
            std::to_string(factors.size()) + " values");
    require(rotation.empty() || rotation.size() == values,
            where + "rotation must hold " + std::to_string(values) + " values",
            std::to_string(rotation.size()) + " values");
    require_finite(factors, where + "factors");
    require_finite(rotation, where + "rotation");
    for (const int bin : bins)
        require(bin >= 0 && bin < length,
                "tone_reader: bins must be 0 to " + std::to_string(length - 1),
                bin);
    return length;
}

} // namespace

channel_equalizer::channel_equalizer(const std::vector<complex>& factors,
                                     int rows,
                                     const std::vector<complex>& rotation,
                                     const std::vector<int>& bins)
    : d_rows(rows),
      d_factors(factors.begin(), factors.end()),
      d_rotation(rotation.begin(), rotation.end()),
      d_bins(bins),
      d_fft(checked_length(factors, rows, rotation, bins))
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

void channel_equalizer::write(fc32* transform, fc32* tones)
{
    for (int row = 0; row < d_rows; row++) {
        fc32* const channel = transform + std::size_t(row) * symbol_length();
        equalize(row, channel, channel);
        for (const int bin : d_bins)
            *tones++ = channel[bin];
    }
}

} // namespace gr::wiforce::kernel
