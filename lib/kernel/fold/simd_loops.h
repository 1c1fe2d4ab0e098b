// SPDX-License-Identifier: GPL-3.0-or-later
// The inner loops of simd_kernels.h. Included by one source file per instruction set,
// which defines WIFORCE_SIMD (a namespace) and WIFORCE_LANES (floats per register). No
// inline function of a library may be used here: the linker could keep the copy built for
// the newest processor for everyone.
#include "../types.h"
#include "simd_kernels.h"

#ifdef __ARM_NEON
#include <arm_neon.h>
#endif

namespace gr::wiforce::kernel::WIFORCE_SIMD {

namespace {

constexpr int LANES = WIFORCE_LANES;
constexpr int DEFAULT_WIDTH = 2 * DEFAULT_SYMBOL_LENGTH;
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

typedef std::int32_t integer_lanes __attribute__((vector_size(4 * LANES)));
typedef std::int16_t short_lanes
    __attribute__((vector_size(2 * LANES), aligned(2), may_alias));

struct fc32_samples {
    using component = float;
    using sum = lanes;
    static sum load(const float* x) { return *reinterpret_cast<const lanes*>(x); }
    static lanes to_float(sum s) { return s; }
    static float one(float x) { return x; }
};

struct sc16_samples {
    using component = std::int16_t;
    using sum = integer_lanes;
    static sum load(const std::int16_t* x)
    {
#ifdef __ARM_NEON
        // GCC 12 takes the conversion below for four numbers, one after the other.
        static_assert(LANES == 4, "lanes of NEON");
        return reinterpret_cast<integer_lanes>(vmovl_s16(vld1_s16(x)));
#else
        return __builtin_convertvector(*reinterpret_cast<const short_lanes*>(x),
                                       integer_lanes);
#endif
    }
    static lanes to_float(sum s) { return __builtin_convertvector(s, lanes); }
    static std::int32_t one(std::int16_t x) { return x; }
};

// Frames lie apart, so the processor's own prefetcher meets each one anew. Two frames
// ahead cover the latency of memory.
constexpr int FRAMES_AHEAD = 2;
constexpr int CACHE_LINE = 64; // bytes

// Comparisons of this form become one instruction.
inline lanes smaller(lanes a, lanes b) { return a < b ? a : b; }
inline lanes larger(lanes a, lanes b) { return a > b ? a : b; }

inline float sum_of(lanes values)
{
    float sum = 0;
    for (int n = 0; n < LANES; n++)
        sum += values[n];
    return sum;
}

// REPETITIONS = 0 and WIDTH = 0: known at run time only.
template <class Samples, int REPETITIONS, int WIDTH>
void fold(const typename Samples::component* in,
          std::size_t stride,
          std::size_t frames,
          int repetitions,
          int any_width,
          float scale,
          float* folded,
          float* noise)
{
    constexpr int STEP = CACHE_LINE / sizeof(*in); // components per cache line
    const int count = REPETITIONS ? REPETITIONS : repetitions;
    const int width = WIDTH ? WIDTH : any_width;
    const float unit = scale * count;
    for (std::size_t frame = 0; frame < frames; frame++) {
        const auto* x = in + frame * stride;
        float* out = folded + frame * width;
        lanes smallest = {};
        lanes largest = {};
        int n = 0;
        for (; n + LANES <= width; n += LANES) {
            auto before = Samples::load(x + n);
            auto sum = before;
            lanes low = {};
            lanes high = {};
            for (int r = 1; r < count; r++) {
                const auto value = Samples::load(x + r * width + n);
                sum += value;
                // Taken before squaring: the squares of a strong static path would round
                // the noise away.
                const lanes difference = Samples::to_float(value - before);
                const lanes square = difference * difference;
                low = r == 1 ? square : smaller(low, square);
                high = larger(high, square);
                before = value;
            }
            smallest += low;
            largest += high;
            if (n % STEP == 0)
                for (int r = 0; r < count; r++)
                    __builtin_prefetch(x + FRAMES_AHEAD * stride + r * width + n);
            *reinterpret_cast<lanes*>(out + n) = scale * Samples::to_float(sum);
        }
        float low_rest = 0;
        float high_rest = 0;
        for (; n < width; n++) {
            auto sum = Samples::one(x[n]);
            float low = 0;
            float high = 0;
            for (int r = 1; r < count; r++) {
                const auto value = Samples::one(x[r * width + n]);
                sum += value;
                const float difference = value - Samples::one(x[(r - 1) * width + n]);
                const float square = difference * difference;
                low = r == 1 || square < low ? square : low;
                high = square > high ? square : high;
            }
            low_rest += low;
            high_rest += high;
            out[n] = scale * sum;
        }
        noise[2 * frame] = unit * unit / width * (sum_of(smallest) + low_rest);
        noise[2 * frame + 1] = unit * unit / width * (sum_of(largest) + high_rest);
    }
}

template <class Samples, int WIDTH>
auto fold_of_width(int repetitions)
{
    return repetitions == 4   ? fold<Samples, 4, WIDTH>
           : repetitions == 2 ? fold<Samples, 2, WIDTH>
                              : fold<Samples, 0, WIDTH>;
}

template <class Samples>
void fold_any(const typename Samples::component* in,
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
    run(in, stride, frames, repetitions, width, scale, folded, noise);
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

bool reach(const std::int16_t* in,
           std::size_t stride,
           std::size_t frames,
           std::size_t count,
           std::int16_t limit)
{
    typedef std::int16_t wide
        __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
    wide low = {};
    wide high = {};
    bool rest = false;
    for (std::size_t frame = 0; frame < frames; frame++) {
        const std::int16_t* x = in + frame * stride;
        std::size_t n = 0;
        for (; n + 2 * LANES <= count; n += 2 * LANES) {
            const wide v = *reinterpret_cast<const wide*>(x + n);
            low = v < low ? v : low;
            high = v > high ? v : high;
        }
        for (; n < count; n++)
            rest |= x[n] >= limit || x[n] <= -limit;
    }
    for (int n = 0; n < 2 * LANES; n++)
        rest |= high[n] >= limit || low[n] <= -limit;
    return rest;
}

} // namespace

extern const simd_kernels kernels;
const simd_kernels kernels = { WIFORCE_SIMD_NAME,
                               fold_any<fc32_samples>,
                               fold_any<sc16_samples>,
                               accumulate,
                               are_finite,
                               reach };

} // namespace gr::wiforce::kernel::WIFORCE_SIMD
