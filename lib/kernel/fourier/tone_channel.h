// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "channel_equalizer.h"

namespace gr::wiforce::kernel {

// The channel at each tone of a group on the occupied subcarriers.
class tone_channel
{
public:
    // `bins` are the FFT bins to keep, in order. Throws std::invalid_argument as
    // channel_equalizer does, and when a bin is not below the symbol's length.
    tone_channel(const std::vector<std::complex<double>>& factors,
                 int rows,
                 const std::vector<std::complex<double>>& rotation,
                 const std::vector<int>& bins);

    const std::vector<int>& bins() const { return d_bins; }

    int symbol_length() const { return d_equalizer.symbol_length(); }

    // Equalizes rows x symbol_length values in place, and appends the bins of each row to
    // `tones`.
    void append(fc32* transform, std::vector<fc32>& tones);

private:
    channel_equalizer d_equalizer;
    const std::vector<int> d_bins;
};

} // namespace gr::wiforce::kernel
