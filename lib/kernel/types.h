// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <complex>
#include <cstdint>

namespace gr::wiforce::kernel {

using complex = std::complex<double>;
using fc32 = std::complex<float>;
using sc16 = std::complex<std::int16_t>;
// Values of both ends of a sensor.
using pair_of_ends = std::array<double, 2>;

// Samples of the symbol that is averaged: those of a folded vector, and points of its
// Fourier transform.
constexpr int DEFAULT_SYMBOL_LENGTH = 64;
constexpr int SHORTEST_SYMBOL = 16;
constexpr int LONGEST_SYMBOL = 4096;

// How much the averaged repetitions of a frame differ: half the squared difference of
// neighbouring repetitions, mean over the samples, which is the power of the noise in
// one sample where a single difference is taken. Of the differences at each sample (real
// and imaginary parts apart) the smallest, and the largest. An edge of a tag shows in one
// of them at each sample, interference over the whole frame in all. Both are 0 where
// there is only one repetition: nothing is known. The largest is NaN where a value of the
// vector is not finite.
struct snapshot_noise {
    float smallest;
    float largest;
};

// Any thread may count, and read it.
class counter
{
public:
    counter() = default;
    counter(const counter& other) : d_value(other) {}

    operator std::uint64_t() const { return d_value.load(std::memory_order_relaxed); }
    void operator+=(std::uint64_t more)
    {
        d_value.fetch_add(more, std::memory_order_relaxed);
    }

private:
    std::atomic<std::uint64_t> d_value{ 0 };
};

} // namespace gr::wiforce::kernel
