// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <vector>

namespace gr::wiforce::kernel {

/*
 * What stands before and after the transform of folded vectors: each row's samples are
 * turned by its rotation, and its spectrum becomes the channel, H[k] = factors[k]
 * spectrum[k], bins in natural FFT order. Zero factors leave unoccupied subcarriers at
 * zero. The transform itself is its caller's part.
 */
class channel_equalizer
{
public:
    // Throws std::invalid_argument unless there are 64 finite factors and, where there is
    // a rotation at all, 64 finite values a row.
    explicit channel_equalizer(const std::vector<std::complex<double>>& factors,
                               int rows = 1,
                               const std::vector<std::complex<double>>& rotation = {});

    int rows() const { return d_rows; }
    void rotate(int row, const fc32* samples, fc32* rotated) const;
    void equalize(const fc32* spectrum, fc32* channel) const;

private:
    int d_rows;
    std::vector<fc32> d_factors;
    std::vector<fc32> d_rotation;
};

} // namespace gr::wiforce::kernel
