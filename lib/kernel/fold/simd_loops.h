// SPDX-License-Identifier: GPL-3.0-or-later
// The inner loops of simd_kernels.h. Included by one source file per instruction set,
// which defines WIFORCE_SIMD (a namespace) and WIFORCE_LANES (floats per register). No
// inline function of a library may be used here: the linker could keep the copy built for
// the newest processor for everyone.
#include "../types.h"
#include "simd_kernels.h"

// Pairs of one number of each of two registers: those of the first half, and of the last.
#if WIFORCE_LANES == 4
#define WIFORCE_FIRST_PAIRS 0, 4, 1, 5
#define WIFORCE_LAST_PAIRS 2, 6, 3, 7
#elif WIFORCE_LANES == 8
#define WIFORCE_FIRST_PAIRS 0, 8, 1, 9, 2, 10, 3, 11
#define WIFORCE_LAST_PAIRS 4, 12, 5, 13, 6, 14, 7, 15
#else
#define WIFORCE_FIRST_PAIRS 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23
#define WIFORCE_LAST_PAIRS 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31
#endif
#if defined(__clang__) || __GNUC__ >= 12
#define WIFORCE_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define WIFORCE_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, integer_lanes{ __VA_ARGS__ })
#endif

namespace gr::wiforce::kernel::WIFORCE_SIMD {

namespace {

constexpr int LANES = WIFORCE_LANES;
constexpr int DEFAULT_WIDTH = 2 * DEFAULT_SYMBOL_LENGTH;
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

typedef std::int32_t integer_lanes
    __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
typedef std::uint32_t unsigned_lanes __attribute__((vector_size(4 * LANES), may_alias));
// Twice as many 16-bit integers.
typedef std::int16_t short_lanes
    __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
typedef std::uint16_t magnitudes __attribute__((vector_size(4 * LANES), may_alias));

// Comparisons of this form become one instruction.
template <class Lanes>
inline Lanes smaller(Lanes a, Lanes b)
{
    return a < b ? a : b;
}

template <class Lanes>
inline Lanes larger(Lanes a, Lanes b)
{
    return a > b ? a : b;
}

// What a frame's repetitions differ by: squares, summed over the components.
struct frame_noise {
    lanes smallest = {};
    lanes largest = {};
    float smallest_rest = 0;
    float largest_rest = 0;
};

/*
 * The sums of the repetitions of STEP neighbouring components, scaled, and what the
 * repetitions differ by. They lie `width` apart; REPETITIONS = 0 when their number
 * is known at run time only.
 */
struct fc32_samples {
    using component = float;
    static constexpr int STEP = LANES;

    static lanes at(const float* x) { return *reinterpret_cast<const lanes*>(x); }

    template <int REPETITIONS>
    void step(
        const float* x, int width, int count, float scale, float* out, frame_noise& noise)
    {
        lanes before = at(x);
        lanes sum = before;
        lanes low = {};
        lanes high = {};
        for (int r = 1; r < (REPETITIONS ? REPETITIONS : count); r++) {
            const lanes value = at(x + r * width);
            sum += value;
            // Taken before squaring: the squares of a strong static path would round the
            // noise away.
            const lanes difference = value - before;
            const lanes square = difference * difference;
            low = r == 1 ? square : smaller(low, square);
            high = larger(high, square);
            before = value;
        }
        noise.smallest += low;
        noise.largest += high;
        *reinterpret_cast<lanes*>(out) = scale * sum;
    }

    static float one(float x) { return x; }
    // Floats have no full scale.
    void see(float) {}
    int peak() const { return 0; }
};

struct sc16_samples {
    using component = std::int16_t;
    static constexpr int STEP = 2 * LANES;

    static short_lanes at(const std::int16_t* x)
    {
        return *reinterpret_cast<const short_lanes*>(x);
    }
    static lanes to_float(integer_lanes values)
    {
        return __builtin_convertvector(values, lanes);
    }

    template <int REPETITIONS>
    void step(const std::int16_t* x,
              int width,
              int count,
              float scale,
              float* out,
              frame_noise& noise)
    {
        // Real and imaginary parts are the halves of 32-bit integers: two shifts take
        // less time than a conversion, and need no order until the sums are stored.
        short_lanes before = at(x);
        integer_lanes real = {};
        integer_lanes imaginary = {};
        const auto add = [&](short_lanes value) {
            const auto both = reinterpret_cast<integer_lanes>(value);
            real += reinterpret_cast<integer_lanes>(reinterpret_cast<unsigned_lanes>(both)
                                                    << 16) >>
                    16;
            imaginary += both >> 16;
        };
        add(before);
        if (count == 1)
            see(before, before);
        magnitudes low = {};
        magnitudes high = {};
        for (int r = 1; r < (REPETITIONS ? REPETITIONS : count); r++) {
            const short_lanes value = at(x + r * width);
            add(value);
            const short_lanes below = smaller(before, value);
            const short_lanes above = larger(before, value);
            see(below, above);
            // Differences of 16-bit integers need all 16 bits, and no sign.
            const auto difference =
                reinterpret_cast<magnitudes>(above) - reinterpret_cast<magnitudes>(below);
            low = r == 1 ? difference : smaller(low, difference);
            high = larger(high, difference);
            before = value;
        }
        noise.smallest += squares(low);
        noise.largest += squares(high);
        const lanes re = scale * to_float(real);
        const lanes im = scale * to_float(imaginary);
        *reinterpret_cast<lanes*>(out) = WIFORCE_SHUFFLE(re, im, WIFORCE_FIRST_PAIRS);
        *reinterpret_cast<lanes*>(out + LANES) =
            WIFORCE_SHUFFLE(re, im, WIFORCE_LAST_PAIRS);
    }

    static std::int32_t one(std::int16_t x) { return x; }
    void see(std::int16_t x)
    {
        d_rest = x > d_rest ? x : d_rest;
        d_rest = -x > d_rest ? -x : d_rest;
    }
    // The largest magnitude of all samples.
    int peak() const
    {
        int most = d_rest;
        for (int n = 0; n < STEP; n++) {
            most = d_high[n] > most ? d_high[n] : most;
            most = -d_low[n] > most ? -d_low[n] : most;
        }
        return most;
    }

private:
    void see(short_lanes below, short_lanes above)
    {
        d_low = smaller(d_low, below);
        d_high = larger(d_high, above);
    }
    // Of both halves of each integer.
    static lanes squares(magnitudes values)
    {
        const auto both = reinterpret_cast<unsigned_lanes>(values);
        const lanes first = to_float(reinterpret_cast<integer_lanes>(both & 0xffff));
        const lanes second = to_float(reinterpret_cast<integer_lanes>(both >> 16));
        return first * first + second * second;
    }

    short_lanes d_low = {};
    short_lanes d_high = {};
    int d_rest = 0;
};

// Frames lie apart, so the processor's own prefetcher meets each one anew. Two frames
// ahead cover the latency of memory.
constexpr int FRAMES_AHEAD = 2;
constexpr int CACHE_LINE = 64; // bytes

inline float sum_of(lanes values)
{
    float sum = 0;
    for (int n = 0; n < LANES; n++)
        sum += values[n];
    return sum;
}

// REPETITIONS = 0 and WIDTH = 0: known at run time only.
template <class Samples, int REPETITIONS, int WIDTH>
int fold(const typename Samples::component* in,
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
        noise[2 * frame] =
            unit * unit / width * (sum_of(levels.smallest) + levels.smallest_rest);
        noise[2 * frame + 1] =
            unit * unit / width * (sum_of(levels.largest) + levels.largest_rest);
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
int fold_any(const typename Samples::component* in,
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
