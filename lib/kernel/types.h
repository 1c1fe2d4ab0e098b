// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstdint>

namespace gr::wiforce::kernel {

using fc32 = std::complex<float>;
using sc16 = std::complex<std::int16_t>;

constexpr int FFT_LENGTH = 64;
constexpr int WIDTH = 2 * FFT_LENGTH; // real and imaginary parts of one folded vector

// How much the averaged repetitions of a frame differ: half the squared difference of
// neighbouring repetitions, mean over the 64 samples, which is the power of the noise in
// one sample where a single difference is taken. Of the differences at each sample (real
// and imaginary parts apart) the smallest, and the largest. An edge of a tag shows in one
// of them at each sample, interference over the whole frame in all. Both are 0 where
// there is only one repetition: nothing is known.
struct snapshot_noise {
    float smallest;
    float largest;
};

} // namespace gr::wiforce::kernel
