// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fourier/fourier_transform.h"
#include "doppler_transform.h"

namespace gr::wiforce::kernel {

// The whole Doppler spectrum of a phase group, scaled by 1/N_g: N_g rows in natural FFT
// order.
class doppler_spectrum : public doppler_transform
{
public:
    // Throws std::invalid_argument unless group_length >= 1.
    explicit doppler_spectrum(int group_length);
    int rows() const override { return d_fft.length(); }
    bool rejects_interference() const override { return false; }
    void transform(const phase_group& group, fc32* out) override;

private:
    fourier_transform d_fft;
};

} // namespace gr::wiforce::kernel
