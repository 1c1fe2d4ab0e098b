// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "types.h"

#include <array>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * Turns the spectrum of a folded vector into the channel: H[k] = factors[k] spectrum[k],
 * bins in natural FFT order. Zero factors leave unoccupied subcarriers at zero. The
 * transform itself is its caller's part.
 */
class channel_equalizer
{
public:
    // Throws std::invalid_argument unless there are 64 finite factors.
    explicit channel_equalizer(const std::vector<std::complex<double>>& factors);

    void equalize(const fc32* spectrum, fc32* channel) const;

private:
    std::array<fc32, FFT_LENGTH> d_factors;
};

} // namespace gr::wiforce::kernel
