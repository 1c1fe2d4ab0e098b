// SPDX-License-Identifier: GPL-3.0-or-later
// The inner loops of simd_kernels.h. Included by one source file per instruction set,
// which defines WIFORCE_SIMD (a namespace) and WIFORCE_LANES (floats per register). No
// inline function of a library may be used here: the linker could keep the copy built for
// the newest processor for everyone.
#include "../types.h"
#include "simd_kernels.h"
#include "simd_samples.h"

namespace gr::wiforce::kernel::WIFORCE_SIMD {

namespace {

constexpr int DEFAULT_WIDTH = 2 * DEFAULT_SYMBOL_LENGTH;

// Frames lie apart, so the processor's own prefetcher meets each one anew. Two frames
// ahead cover the latency of memory.
constexpr int FRAMES_AHEAD = 2;
constexpr int CACHE_LINE = 64; // bytes

// The sum of each of two registers. Half of the additions are made at once: they follow
// each other, and the next frame waits for them.
inline void sums_of(lanes a, lanes b, float& sum_of_a, float& sum_of_b)
{
    const lanes pairs = WIFORCE_SHUFFLE(integer_lanes, a, b, WIFORCE_FIRST_PAIRS) +
                        WIFORCE_SHUFFLE(integer_lanes, a, b, WIFORCE_LAST_PAIRS);
    for (int n = 0; n < LANES; n += 2) {
        sum_of_a += pairs[n];
        sum_of_b += pairs[n + 1];
    }
}

// REPETITIONS = 0 and WIDTH = 0: known at run time only.
template <class Samples, int REPETITIONS, int WIDTH>
float fold(const typename Samples::component* in,
           std::size_t stride,
           std::size_t frames,
           int repetitions,
           int any_width,
           float scale,
           float* folded,
           float* noise)
{
    constexpr int LINE = CACHE_LINE / sizeof(*in); // components
    const int count = REPETITIONS ? REPETITIONS : repetitions;
    const int width = WIDTH ? WIDTH : any_width;
    const float unit = scale * count;
    Samples samples;
    for (std::size_t frame = 0; frame < frames; frame++) {
        const auto* x = in + frame * stride;
        float* out = folded + frame * width;
        frame_noise levels;
        int n = 0;
        for (; n + Samples::STEP <= width; n += Samples::STEP) {
            if (n % LINE == 0)
                for (int r = 0; r < count; r++)
                    __builtin_prefetch(x + FRAMES_AHEAD * stride + r * width + n);
            samples.template step<REPETITIONS>(
                x + n, width, count, scale, out + n, levels);
        }
        for (; n < width; n++) {
            auto sum = Samples::one(x[n]);
            float low = 0;
            float high = 0;
            samples.see(x[n]);
            for (int r = 1; r < count; r++) {
                const auto value = Samples::one(x[r * width + n]);
                samples.see(x[r * width + n]);
                sum += value;
                const float difference = value - Samples::one(x[(r - 1) * width + n]);
                const float square = difference * difference;
                low = r == 1 || square < low ? square : low;
                high = square > high ? square : high;
            }
            levels.smallest_rest += low;
            levels.largest_rest += high;
            out[n] = scale * sum;
        }
        sums_of(
            levels.smallest, levels.largest, levels.smallest_rest, levels.largest_rest);
        noise[2 * frame] = unit * unit / width * levels.smallest_rest;
        noise[2 * frame + 1] = unit * unit / width * levels.largest_rest;
    }
    return samples.peak();
}

template <class Samples, int WIDTH>
auto fold_of_width(int repetitions)
{
    return repetitions == 4   ? fold<Samples, 4, WIDTH>
           : repetitions == 2 ? fold<Samples, 2, WIDTH>
                              : fold<Samples, 0, WIDTH>;
}

template <class Samples>
float fold_any(const typename Samples::component* in,
               std::size_t stride,
               std::size_t frames,
               int repetitions,
               int width,
               float scale,
               float* folded,
               float* noise)
{
    const auto run = width == DEFAULT_WIDTH
                         ? fold_of_width<Samples, DEFAULT_WIDTH>(repetitions)
                         : fold_of_width<Samples, 0>(repetitions);
    return run(in, stride, frames, repetitions, width, scale, folded, noise);
}

// A tile of ROWS x (COLUMNS * LANES) sums stays in registers over all snapshots.
template <int ROWS, int COLUMNS>
inline void accumulate_tile(const float* snapshots,
                            const float* reference,
                            const float* weights,
                            int count,
                            int rows,
                            int width,
                            float* sums)
{
    lanes tile[ROWS][COLUMNS];
    lanes zero_level[COLUMNS];
    for (int c = 0; c < COLUMNS; c++) {
        zero_level[c] = *reinterpret_cast<const lanes*>(reference + c * LANES);
        for (int r = 0; r < ROWS; r++)
            tile[r][c] = *reinterpret_cast<const lanes*>(sums + r * width + c * LANES);
    }
    for (int n = 0; n < count; n++) {
        // A column is a line of each snapshot, which the processor does not expect.
        __builtin_prefetch(snapshots + n * width + CACHE_LINE / sizeof(float));
        lanes difference[COLUMNS];
        for (int c = 0; c < COLUMNS; c++)
            difference[c] =
                *reinterpret_cast<const lanes*>(snapshots + n * width + c * LANES) -
                zero_level[c];
        for (int r = 0; r < ROWS; r++)
            for (int c = 0; c < COLUMNS; c++)
                tile[r][c] += weights[n * rows + r] * difference[c];
    }
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++)
            *reinterpret_cast<lanes*>(sums + r * width + c * LANES) = tile[r][c];
}

// The last columns, fewer than a register holds.
inline void accumulate_rest(const float* snapshots,
                            const float* reference,
                            const float* weights,
                            int count,
                            int rows,
                            int width,
                            int first,
                            float* sums)
{
    for (int r = 0; r < rows; r++)
        for (int c = first; c < width; c++) {
            float sum = sums[r * width + c];
            for (int n = 0; n < count; n++)
                sum += weights[n * rows + r] * (snapshots[n * width + c] - reference[c]);
            sums[r * width + c] = sum;
        }
}

template <int WIDTH>
void accumulate_width(const float* snapshots,
                      const float* reference,
                      const float* weights,
                      int count,
                      int rows,
                      int any_width,
                      float* sums)
{
    const int width = WIDTH ? WIDTH : any_width;
    int row = 0;
    for (; row + 8 <= rows; row += 8)
        for (int c = 0; c + LANES <= width; c += LANES)
            accumulate_tile<8, 1>(snapshots + c,
                                  reference + c,
                                  weights + row,
                                  count,
                                  rows,
                                  width,
                                  sums + row * width + c);
    for (; row < rows; row += 4) {
        int c = 0;
        for (; c + 2 * LANES <= width; c += 2 * LANES)
            accumulate_tile<4, 2>(snapshots + c,
                                  reference + c,
                                  weights + row,
                                  count,
                                  rows,
                                  width,
                                  sums + row * width + c);
        for (; c + LANES <= width; c += LANES)
            accumulate_tile<4, 1>(snapshots + c,
                                  reference + c,
                                  weights + row,
                                  count,
                                  rows,
                                  width,
                                  sums + row * width + c);
    }
    accumulate_rest(
        snapshots, reference, weights, count, rows, width, width / LANES * LANES, sums);
}

void accumulate(const float* snapshots,
                const float* reference,
                const float* weights,
                int count,
                int rows,
                int width,
                float* sums)
{
    const auto run =
        width == DEFAULT_WIDTH ? accumulate_width<DEFAULT_WIDTH> : accumulate_width<0>;
    run(snapshots, reference, weights, count, rows, width, sums);
}

bool are_finite(const float* values, std::size_t count)
{
    typedef std::uint32_t bits __attribute__((may_alias, aligned(4)));
    const bits* x = reinterpret_cast<const bits*>(values);
    constexpr std::uint32_t exponent = 0x7f800000;
    std::uint32_t largest = 0;
    for (std::size_t n = 0; n < count; n++) {
        const std::uint32_t e = x[n] & exponent;
        largest = largest > e ? largest : e;
    }
    return largest < exponent;
}

} // namespace

extern const simd_kernels kernels;
const simd_kernels kernels = { WIFORCE_SIMD_NAME,
                               fold_any<fc32_samples>,
                               fold_any<sc16_samples>,
                               accumulate,
                               are_finite };

} // namespace gr::wiforce::kernel::WIFORCE_SIMD
