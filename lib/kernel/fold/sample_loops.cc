// SPDX-License-Identifier: GPL-3.0-or-later
#include "sample_loops.h"

#include "../clones.h"
#include "../types.h"

#include <cstring>

// Functions are built for an instruction set as parts of the one that calls them.
#define WIFORCE_INLINE __attribute__((always_inline)) inline

namespace gr::wiforce::kernel {

namespace {

constexpr int DEFAULT_WIDTH = 2 * DEFAULT_SYMBOL_LENGTH;

// Frames lie apart, so the processor's own prefetcher meets each one anew. More lines can
// be on their way from memory to the second cache than to the first.
constexpr int FRAMES_TO_FIRST = 1;
constexpr int FRAMES_TO_SECOND = 4;
constexpr int CACHE_LINE = 64; // bytes

constexpr int LANES = 8;
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef std::int32_t integer_lanes __attribute__((vector_size(4 * LANES)));
typedef std::uint32_t unsigned_lanes __attribute__((vector_size(4 * LANES), may_alias));
// Twice as many 16-bit integers.
typedef std::int16_t short_lanes
    __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
typedef std::uint16_t magnitudes __attribute__((vector_size(4 * LANES), may_alias));

WIFORCE_INLINE lanes lanes_at(const float* x)
{
    return *reinterpret_cast<const lanes*>(x);
}

// Comparisons of this form become one instruction.
template <class Lanes>
WIFORCE_INLINE Lanes smaller(Lanes a, Lanes b)
{
    return a < b ? a : b;
}

template <class Lanes>
WIFORCE_INLINE Lanes larger(Lanes a, Lanes b)
{
    return a > b ? a : b;
}

// Half of the additions are independent: the next frame waits for them.
WIFORCE_INLINE float sum_of(lanes values)
{
    float sum = 0;
    for (int n = 0; n < LANES / 2; n++)
        sum += values[n] + values[n + LANES / 2];
    return sum;
}

// What a frame's repetitions differ by: squares, summed over the components.
struct frame_noise {
    lanes smallest = {};
    lanes largest = {};
};

/*
 * The sums of the repetitions of STEP neighbouring components, scaled, and what the
 * repetitions differ by. They lie `width` apart.
 */
struct fc32_samples {
    static constexpr int STEP = LANES;

    WIFORCE_INLINE void step(const float* x,
                             int width,
                             int repetitions,
                             float scale,
                             float* out,
                             frame_noise& noise)
    {
        lanes before = lanes_at(x);
        lanes sum = before;
        lanes low = {};
        lanes high = {};
        see(before);
        for (int r = 1; r < repetitions; r++) {
            const lanes value = lanes_at(x + r * width);
            sum += value;
            see(value);
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

    // The largest magnitude of all samples; not finite where one of them is not.
    WIFORCE_INLINE float peak() const
    {
        std::int32_t most = 0;
        for (int n = 0; n < STEP; n++)
            most = larger<std::int32_t>(d_most[n], most);
        float value;
        std::memcpy(&value, &most, sizeof(value));
        return value;
    }

private:
    // As integers, magnitudes are in the same order, and NaN is above all of them.
    static constexpr std::int32_t MAGNITUDE = 0x7fffffff;
    WIFORCE_INLINE void see(lanes values)
    {
        d_most = larger(d_most, reinterpret_cast<integer_lanes>(values) & MAGNITUDE);
    }

    integer_lanes d_most = {};
};

struct sc16_samples {
    static constexpr int STEP = 2 * LANES;

    static WIFORCE_INLINE short_lanes at(const std::int16_t* x)
    {
        return *reinterpret_cast<const short_lanes*>(x);
    }
    // The numbers at even and at odd places.
    static WIFORCE_INLINE integer_lanes even(short_lanes x)
    {
        const auto both = reinterpret_cast<unsigned_lanes>(x);
        return reinterpret_cast<integer_lanes>(both << 16) >> 16;
    }
    static WIFORCE_INLINE integer_lanes odd(short_lanes x)
    {
        return reinterpret_cast<integer_lanes>(x) >> 16;
    }
    static WIFORCE_INLINE lanes to_float(integer_lanes values)
    {
        return __builtin_convertvector(values, lanes);
    }

    WIFORCE_INLINE void step(const std::int16_t* x,
                             int width,
                             int repetitions,
                             float scale,
                             float* out,
                             frame_noise& noise)
    {
        short_lanes before = at(x);
        if (repetitions % 2)
            see(before, before);
        integer_lanes first = even(before);
        integer_lanes last = odd(before);
        magnitudes low = {};
        magnitudes high = {};
        for (int r = 1; r < repetitions; r++) {
            const short_lanes value = at(x + r * width);
            first += even(value);
            last += odd(value);
            const short_lanes below = smaller(before, value);
            const short_lanes above = larger(before, value);
            if ((repetitions - r) % 2)
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
        const lanes a = scale * to_float(first);
        const lanes b = scale * to_float(last);
        for (int n = 0; n < LANES; n++) {
            out[2 * n] = a[n];
            out[2 * n + 1] = b[n];
        }
    }

    // The largest magnitude of all samples.
    WIFORCE_INLINE float peak() const
    {
        float most = 0;
        for (int n = 0; n < STEP; n++)
            most = larger(larger<float>(d_high[n], -float(d_low[n])), most);
        return most;
    }

private:
    WIFORCE_INLINE void see(short_lanes below, short_lanes above)
    {
        d_low = smaller(d_low, below);
        d_high = larger(d_high, above);
    }
    // Of both halves of each integer.
    static WIFORCE_INLINE lanes squares(magnitudes values)
    {
        const auto both = reinterpret_cast<unsigned_lanes>(values);
        const lanes first = to_float(reinterpret_cast<integer_lanes>(both & 0xffff));
        const lanes second = to_float(reinterpret_cast<integer_lanes>(both >> 16));
        return first * first + second * second;
    }

    short_lanes d_low = {};
    short_lanes d_high = {};
};

template <class Samples, class Frames>
WIFORCE_INLINE float
fold(Frames of, int repetitions, int width, float scale, float* folded, float* noise)
{
    constexpr int LINE = CACHE_LINE / sizeof(*of.in); // components
    const float unit = scale * repetitions;
    Samples samples;
    for (std::size_t frame = 0; frame < of.frames; frame++) {
        const auto* x = of.in + frame * of.stride;
        float* out = folded + frame * width;
        frame_noise levels;
        int n = 0;
        for (; n + Samples::STEP <= width; n += Samples::STEP) {
            if (n % LINE == 0)
                for (int r = 0; r < repetitions; r++) {
                    const auto* const line = x + r * width + n;
                    __builtin_prefetch(line + FRAMES_TO_SECOND * of.stride, 0, 2);
                    __builtin_prefetch(line + FRAMES_TO_FIRST * of.stride);
                }
            samples.step(x + n, width, repetitions, scale, out + n, levels);
        }
        if (n < width) { // the last ones, beside some that were seen already
            const int first = width - Samples::STEP;
            frame_noise last;
            samples.step(x + first, width, repetitions, scale, out + first, last);
            for (int i = (n - first) * LANES / Samples::STEP; i < LANES; i++) {
                levels.smallest[i] += last.smallest[i];
                levels.largest[i] += last.largest[i];
            }
        }
        const float each = unit * unit / width;
        noise[2 * frame] = each * sum_of(levels.smallest);
        noise[2 * frame + 1] = each * sum_of(levels.largest);
    }
    return samples.peak();
}

// Frequent numbers as constants, for which the loops are unrolled.
template <class Samples, class Frames, class... Rest>
WIFORCE_INLINE float fold_any(Frames of, Rest... rest)
{
    if (of.width == DEFAULT_WIDTH && of.repetitions == 4)
        return fold<Samples>(of, 4, DEFAULT_WIDTH, rest...);
    if (of.width == DEFAULT_WIDTH && of.repetitions == 2)
        return fold<Samples>(of, 2, DEFAULT_WIDTH, rest...);
    return fold<Samples>(of, of.repetitions, of.width, rest...);
}

// A tile of ROWS x (COLUMNS * LANES) sums stays in registers over all snapshots.
template <int ROWS, int COLUMNS>
WIFORCE_INLINE void
accumulate_tile(weighted_vectors of, int width, int row, int column, float* sums)
{
    const float* const snapshots = of.snapshots + column;
    const float* const weights = of.weights + row;
    sums += row * width + column;
    lanes tile[ROWS][COLUMNS];
    lanes zero_level[COLUMNS];
    for (int c = 0; c < COLUMNS; c++) {
        zero_level[c] = lanes_at(of.reference + column + c * LANES);
        for (int r = 0; r < ROWS; r++)
            tile[r][c] = lanes_at(sums + r * width + c * LANES);
    }
    for (int n = 0; n < of.count; n++) {
        // A column is a line of each snapshot, which the processor does not expect.
        __builtin_prefetch(snapshots + n * width + CACHE_LINE / sizeof(float));
        lanes difference[COLUMNS];
        for (int c = 0; c < COLUMNS; c++)
            difference[c] = lanes_at(snapshots + n * width + c * LANES) - zero_level[c];
        for (int r = 0; r < ROWS; r++)
            for (int c = 0; c < COLUMNS; c++)
                tile[r][c] += weights[n * of.rows + r] * difference[c];
    }
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++)
            *reinterpret_cast<lanes*>(sums + r * width + c * LANES) = tile[r][c];
}

WIFORCE_INLINE void accumulate_width(weighted_vectors of, int width, float* sums)
{
    int row = 0;
    for (; row + 8 <= of.rows; row += 8)
        for (int c = 0; c + LANES <= width; c += LANES)
            accumulate_tile<8, 1>(of, width, row, c, sums);
    for (; row < of.rows; row += 4) {
        int c = 0;
        for (; c + 2 * LANES <= width; c += 2 * LANES)
            accumulate_tile<4, 2>(of, width, row, c, sums);
        for (; c + LANES <= width; c += LANES)
            accumulate_tile<4, 1>(of, width, row, c, sums);
    }
    // The last columns, fewer than a register holds.
    for (row = 0; row < of.rows; row++)
        for (int c = width / LANES * LANES; c < width; c++) {
            float sum = sums[row * width + c];
            for (int n = 0; n < of.count; n++)
                sum += of.weights[n * of.rows + row] *
                       (of.snapshots[n * width + c] - of.reference[c]);
            sums[row * width + c] = sum;
        }
}

} // namespace

WIFORCE_CLONES
float fold_samples(const repeated_symbols<float>& of,
                   float scale,
                   float* folded,
                   float* noise)
{
    return fold_any<fc32_samples>(of, scale, folded, noise);
}

WIFORCE_CLONES
float fold_samples(const repeated_symbols<std::int16_t>& of,
                   float scale,
                   float* folded,
                   float* noise)
{
    return fold_any<sc16_samples>(of, scale, folded, noise);
}

WIFORCE_CLONES
void accumulate(const weighted_vectors& of, float* sums)
{
    if (of.width == DEFAULT_WIDTH)
        accumulate_width(of, DEFAULT_WIDTH, sums);
    else
        accumulate_width(of, of.width, sums);
}

WIFORCE_CLONES
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

} // namespace gr::wiforce::kernel
