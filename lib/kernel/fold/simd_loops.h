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
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

typedef std::int32_t integer_lanes __attribute__((vector_size(4 * LANES)));
typedef std::int16_t short_lanes
    __attribute__((vector_size(2 * LANES), aligned(2), may_alias));

struct fc32_samples {
    using component = float;
    using sum = lanes;
    static sum load(const float* x) { return *reinterpret_cast<const lanes*>(x); }
    static lanes to_float(sum s) { return s; }
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

// REPETITIONS = 0: known at run time only.
template <class Samples, int REPETITIONS>
void fold(const typename Samples::component* in,
          std::size_t stride,
          std::size_t frames,
          int repetitions,
          float scale,
          float* folded,
          float* noise)
{
    constexpr int STEP = CACHE_LINE / sizeof(*in); // components per cache line
    const int count = REPETITIONS ? REPETITIONS : repetitions;
    const float unit = scale * count;
    for (std::size_t frame = 0; frame < frames; frame++) {
        const auto* x = in + frame * stride;
        float* out = folded + frame * WIDTH;
        lanes smallest = {};
        lanes largest = {};
        for (int n = 0; n < WIDTH; n += LANES) {
            auto before = Samples::load(x + n);
            auto sum = before;
            lanes low = {};
            lanes high = {};
            for (int r = 1; r < count; r++) {
                const auto value = Samples::load(x + r * WIDTH + n);
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
                    __builtin_prefetch(x + FRAMES_AHEAD * stride + r * WIDTH + n);
            *reinterpret_cast<lanes*>(out + n) = scale * Samples::to_float(sum);
        }
        noise[2 * frame] = unit * unit / WIDTH * sum_of(smallest);
        noise[2 * frame + 1] = unit * unit / WIDTH * sum_of(largest);
    }
}

template <class Samples>
void fold_any(const typename Samples::component* in,
              std::size_t stride,
              std::size_t frames,
              int repetitions,
              float scale,
              float* folded,
              float* noise)
{
    if (repetitions == 4)
        fold<Samples, 4>(in, stride, frames, repetitions, scale, folded, noise);
    else if (repetitions == 2)
        fold<Samples, 2>(in, stride, frames, repetitions, scale, folded, noise);
    else
        fold<Samples, 0>(in, stride, frames, repetitions, scale, folded, noise);
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

bool are_finite(const float* vectors, int count)
{
    typedef std::uint32_t bits __attribute__((may_alias, aligned(4)));
    const bits* x = reinterpret_cast<const bits*>(vectors);
    constexpr std::uint32_t exponent = 0x7f800000;
    std::uint32_t largest = 0;
    for (int n = 0; n < count * WIDTH; n++) {
        const std::uint32_t e = x[n] & exponent;
        largest = largest > e ? largest : e;
    }
    return largest < exponent;
}

bool reach(const std::int16_t* in,
           std::size_t stride,
           std::size_t frames,
           int repetitions,
           std::int16_t limit)
{
    typedef std::int16_t wide
        __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
    wide low = {};
    wide high = {};
    for (std::size_t frame = 0; frame < frames; frame++) {
        const std::int16_t* x = in + frame * stride;
        for (int n = 0; n < repetitions * WIDTH; n += 2 * LANES) {
            const wide v = *reinterpret_cast<const wide*>(x + n);
            low = v < low ? v : low;
            high = v > high ? v : high;
        }
    }
    for (int n = 0; n < 2 * LANES; n++)
        if (high[n] >= limit || low[n] <= -limit)
            return true;
    return false;
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
