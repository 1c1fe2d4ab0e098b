// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "fourier_transform.h"

#include <vector>

namespace gr::wiforce::kernel {

/*
 * The channel of folded vectors: each row's samples are multiplied by its rotation,
 * transformed, and divided by what was sent, H[k] = factors[k] X[k], bins in natural FFT
 * order. Zero factors leave unoccupied subcarriers at zero.
 */
class channel_equalizer
{
public:
    // The factors are as many as a symbol has samples. Throws std::invalid_argument
    // unless these are 16 to 4096 and finite and, where there is a rotation at all, it
    // has as many finite values a row.
    explicit channel_equalizer(const std::vector<std::complex<double>>& factors,
                               int rows = 1,
                               const std::vector<std::complex<double>>& rotation = {});

    int rows() const { return d_rows; }
    int symbol_length() const { return static_cast<int>(d_factors.size()); }
    void equalize(int row, const fc32* samples, fc32* channel);

private:
    const int d_rows;
    const std::vector<fc32> d_factors;
    const std::vector<fc32> d_rotation; // rows x symbol_length, or none
    fourier_transform d_fft;
};

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

    // Equalizes rows x symbol_length values in place, and writes the bins of each row.
    void write(fc32* transform, fc32* tones);

private:
    channel_equalizer d_equalizer;
    const std::vector<int> d_bins;
};

} // namespace gr::wiforce::kernel
