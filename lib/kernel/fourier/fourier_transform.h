// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <functional>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The discrete Fourier transform of one length, X[k] = sum_n x[n] exp(-2 pi j k n / N).
 *
 * By FFTW, or in plain C++ where the build has no FFTW. FFTW's plan is chosen by rule and
 * not by measuring, so that every run rounds alike.
 */
class fourier_transform
{
public:
    // length >= 1.
    explicit fourier_transform(int length);
    fourier_transform(const fourier_transform&) = delete;
    fourier_transform& operator=(const fourier_transform&) = delete;

    int length() const { return static_cast<int>(d_input.size()); }
    // Where the next execute() finds x.
    fc32* input() { return d_input.data(); }
    // X, valid until the next call.
    const fc32* execute()
    {
        d_transform(d_input.data(), d_output.data());
        return d_output.data();
    }

private:
    std::vector<fc32> d_input, d_output;
    const std::function<void(fc32* input, fc32* output)> d_transform;
};

} // namespace gr::wiforce::kernel
