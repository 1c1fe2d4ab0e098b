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
    // The factors are as many as a symbol has samples; `bins` are the FFT bins that
    // write() keeps, in order. Throws std::invalid_argument unless the factors are 16 to
    // 4096 and finite, the rotation, where there is one at all, has as many finite values
    // a row, and bins are below the symbol's length.
    explicit channel_equalizer(const std::vector<complex>& factors,
                               int rows = 1,
                               const std::vector<complex>& rotation = {},
                               const std::vector<int>& bins = {});

    int rows() const { return d_rows; }
    int symbol_length() const { return static_cast<int>(d_factors.size()); }
    const std::vector<int>& bins() const { return d_bins; }
    void equalize(int row, const fc32* samples, fc32* channel);

    // Equalizes rows x symbol_length values in place, and writes the bins of each row.
    void write(fc32* transform, fc32* tones);

private:
    const int d_rows;
    const std::vector<fc32> d_factors;
    const std::vector<fc32> d_rotation; // rows x symbol_length, or none
    const std::vector<int> d_bins;
    fourier_transform d_fft;
};

} // namespace gr::wiforce::kernel
