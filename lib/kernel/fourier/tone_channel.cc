// SPDX-License-Identifier: GPL-3.0-or-later
#include "tone_channel.h"

#include "../require.h"

namespace gr::wiforce::kernel {

namespace {

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

tone_channel::tone_channel(const std::vector<std::complex<double>>& factors,
                           int rows,
                           const std::vector<std::complex<double>>& rotation,
                           const std::vector<int>& bins)
    : d_equalizer(factors, rows, rotation), d_bins(checked_bins(bins, symbol_length()))
{
}

void tone_channel::append(fc32* transform, std::vector<fc32>& tones)
{
    for (int row = 0; row < d_equalizer.rows(); row++) {
        fc32* const channel = transform + std::size_t(row) * symbol_length();
        d_equalizer.equalize(row, channel, channel);
        for (const int bin : d_bins)
            tones.push_back(channel[bin]);
    }
}

} // namespace gr::wiforce::kernel
