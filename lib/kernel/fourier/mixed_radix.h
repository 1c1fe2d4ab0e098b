// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <complex>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The discrete Fourier transform in plain C++, for builds without FFTW.
 *
 * Decimation in time by the prime factors of the length (Cooley and Tukey, 1965), in
 * double precision, so that the result differs from the exact transform by the rounding
 * to float only.
 */
class mixed_radix
{
public:
    // length >= 1.
    explicit mixed_radix(int length);
    // X[k] = sum_n x[n] exp(-2 pi j k n / length); input and output must not overlap.
    void execute(const fc32* input, fc32* output);

private:
    using value = std::complex<double>;
    // Transforms the values input[0], input[stride], ... into out[0 .. length - 1].
    void
    transform(const fc32* input, int stride, int length, const int* radix, value* out);

    const int d_length;
    std::vector<int> d_radices;
    std::vector<value> d_roots; // exp(-2 pi j n / length)
    std::vector<value> d_butterfly;
    std::vector<value> d_output;
};

} // namespace gr::wiforce::kernel
