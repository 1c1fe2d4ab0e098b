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

    int length() const { return d_length; }
    // Where the next execute() finds x.
    fc32* input() { return reinterpret_cast<fc32*>(d_input.data()); }
    // X, valid until the next call.
    const fc32* execute()
    {
        d_transform(input(), output());
        return output();
    }

private:
    fc32* output() { return reinterpret_cast<fc32*>(d_output.data()); }

    // As FFTW aligns vectors, also where the allocator does not.
    struct alignas(16) pair {
        fc32 values[2];
    };

    const int d_length;
    std::vector<pair> d_input, d_output;
    const std::function<void(fc32* input, fc32* output)> d_transform;
};

} // namespace gr::wiforce::kernel
