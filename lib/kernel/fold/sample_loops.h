// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>

namespace gr::wiforce::kernel {

// The inner loops over samples, for the instruction set of the processor (clones.h).
// "Vectors" are `width` floats, an even number from 32 on: real and imaginary parts of a
// folded symbol. The default width of 128 has loops of its own, which are unrolled.

template <class Component>
struct repeated_symbols {
    const Component* in;
    std::size_t stride; // from frame to frame
    std::size_t frames;
    int repetitions;
    int width;
};

// folded[width f + n] = scale sum_r in[stride f + width r + n], and in noise[2 f] and
// noise[2 f + 1] the snapshot_noise of frame f for samples scale * repetitions * in.
// Returns the largest magnitude of what was summed, which is not finite where one is not.
float fold_samples(const repeated_symbols<float>& of,
                   float scale,
                   float* folded,
                   float* noise);

// The same on integers: exact for up to 65536 repetitions.
float fold_samples(const repeated_symbols<std::int16_t>& of,
                   float scale,
                   float* folded,
                   float* noise);

struct weighted_vectors {
    const float* snapshots; // count x width
    const float* reference; // width
    const float* weights;   // count x rows
    int count;
    int rows; // a multiple of ROW_BLOCK
    int width;
};

// sums[width r + c] += sum_n weights[rows n + r] (snapshots[width n + c] - reference[c])
// for r < rows.
constexpr int ROW_BLOCK = 4;
void accumulate(const weighted_vectors& of, float* sums);

// Whether `count` floats are finite.
bool are_finite(const float* values, std::size_t count);

} // namespace gr::wiforce::kernel
