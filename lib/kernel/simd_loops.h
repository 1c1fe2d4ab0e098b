// SPDX-License-Identifier: GPL-3.0-or-later
// The inner loops of simd_kernels.h. Included by one source file per instruction set,
// which defines WIFORCE_SIMD (a namespace) and WIFORCE_LANES (floats per register). No
// inline function of a library may be used here: the linker could keep the copy built for
// the newest processor for everyone.
#include "simd_kernels.h"
#include "types.h"

namespace gr::wiforce::kernel::WIFORCE_SIMD {

namespace {

constexpr int LANES = WIFORCE_LANES;
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

template <class Component, class Sum>
void fold(const Component* in,
          std::size_t stride,
          std::size_t frames,
          int repetitions,
          float scale,
          float* folded)
{
    for (std::size_t frame = 0; frame < frames; frame++) {
        const Component* x = in + frame * stride;
        float* out = folded + frame * WIDTH;
        Sum sum[WIDTH];
        for (int n = 0; n < WIDTH; n++)
            sum[n] = x[n];
        for (int r = 1; r < repetitions; r++)
            for (int n = 0; n < WIDTH; n++)
                sum[n] += x[r * WIDTH + n];
        for (int n = 0; n < WIDTH; n++)
            out[n] = scale * static_cast<float>(sum[n]);
    }
}

void fold_fc32(const float* in,
               std::size_t stride,
               std::size_t frames,
               int repetitions,
               float scale,
               float* folded)
{
    fold<float, float>(in, stride, frames, repetitions, scale, folded);
}

void fold_sc16(const std::int16_t* in,
               std::size_t stride,
               std::size_t frames,
               int repetitions,
               float scale,
               float* folded)
{
    fold<std::int16_t, std::int32_t>(in, stride, frames, repetitions, scale, folded);
}

// A tile of ROWS x (COLUMNS * LANES) sums stays in registers over all snapshots.
template <int ROWS, int COLUMNS>
void accumulate_tile(const float* snapshots,
                     const float* reference,
                     const float* weights,
                     int count,
                     int rows,
                     float* sums)
{
    lanes tile[ROWS][COLUMNS];
    lanes zero_level[COLUMNS];
    for (int c = 0; c < COLUMNS; c++) {
        zero_level[c] = *reinterpret_cast<const lanes*>(reference + c * LANES);
        for (int r = 0; r < ROWS; r++)
            tile[r][c] = *reinterpret_cast<const lanes*>(sums + r * WIDTH + c * LANES);
    }
    for (int n = 0; n < count; n++) {
        lanes difference[COLUMNS];
        for (int c = 0; c < COLUMNS; c++)
            difference[c] =
                *reinterpret_cast<const lanes*>(snapshots + n * WIDTH + c * LANES) -
                zero_level[c];
        for (int r = 0; r < ROWS; r++)
            for (int c = 0; c < COLUMNS; c++)
                tile[r][c] += weights[n * rows + r] * difference[c];
    }
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++)
            *reinterpret_cast<lanes*>(sums + r * WIDTH + c * LANES) = tile[r][c];
}

template <int ROWS, int COLUMNS>
void accumulate_rows(const float* snapshots,
                     const float* reference,
                     const float* weights,
                     int count,
                     int rows,
                     float* sums)
{
    for (int column = 0; column < WIDTH; column += COLUMNS * LANES)
        accumulate_tile<ROWS, COLUMNS>(
            snapshots + column, reference + column, weights, count, rows, sums + column);
}

void accumulate(const float* snapshots,
                const float* reference,
                const float* weights,
                int count,
                int rows,
                float* sums)
{
    int row = 0;
    for (; row + 8 <= rows; row += 8)
        accumulate_rows<8, 1>(
            snapshots, reference, weights + row, count, rows, sums + row * WIDTH);
    for (; row < rows; row += 4)
        accumulate_rows<4, 2>(
            snapshots, reference, weights + row, count, rows, sums + row * WIDTH);
}

bool is_finite(const float* vector)
{
    typedef std::uint32_t bits __attribute__((may_alias, aligned(4)));
    const bits* x = reinterpret_cast<const bits*>(vector);
    constexpr std::uint32_t exponent = 0x7f800000;
    std::uint32_t largest = 0;
    for (int n = 0; n < WIDTH; n++) {
        const std::uint32_t e = x[n] & exponent;
        largest = largest > e ? largest : e;
    }
    return largest < exponent;
}

} // namespace

extern const simd_kernels kernels;
const simd_kernels kernels = {
    WIFORCE_SIMD_NAME, fold_fc32, fold_sc16, accumulate, is_finite
};

} // namespace gr::wiforce::kernel::WIFORCE_SIMD
