// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The inner loops, built once per instruction set from the same source (simd_loops.h) and
 * chosen when the program runs. "Vectors" are `width` floats, an even number: the real
 * and imaginary parts of a folded symbol. The default width of 128 has loops of its own,
 * which are unrolled.
 */
struct simd_kernels {
    template <class Component>
    using fold_function = float (*)(const Component* in,
                                    std::size_t stride,
                                    std::size_t frames,
                                    int repetitions,
                                    int width,
                                    float scale,
                                    float* folded,
                                    float* noise);

    const char* name;

    // folded[width f + n] = scale sum_r in[stride f + width r + n], and in noise[2 f] and
    // noise[2 f + 1] the snapshot_noise of frame f for samples scale * repetitions * in.
    // Returns the largest magnitude of what was summed.
    fold_function<float> fold_fc32;

    // The same on integers: exact for up to 65536 repetitions.
    fold_function<std::int16_t> fold_sc16;

    // sums[width r + c] += sum_n weights[rows n + r] (snapshots[width n + c] -
    // reference[c]) for r < rows; rows is a multiple of ROW_BLOCK.
    void (*accumulate)(const float* snapshots,
                       const float* reference,
                       const float* weights,
                       int count,
                       int rows,
                       int width,
                       float* sums);

    // Whether `count` floats are finite.
    bool (*are_finite)(const float* values, std::size_t count);

    static constexpr int ROW_BLOCK = 4;
};

// The best this processor runs.
const simd_kernels& fastest_kernels();

// All that this processor runs, the best last.
std::vector<const simd_kernels*> usable_kernels();

} // namespace gr::wiforce::kernel
