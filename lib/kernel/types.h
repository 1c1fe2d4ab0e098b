// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstdint>

namespace gr::wiforce::kernel {

using fc32 = std::complex<float>;
using sc16 = std::complex<std::int16_t>;

constexpr int FFT_LENGTH = 64;
constexpr int WIDTH = 2 * FFT_LENGTH; // real and imaginary parts of one folded vector

} // namespace gr::wiforce::kernel
