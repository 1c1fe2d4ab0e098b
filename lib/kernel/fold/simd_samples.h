// SPDX-License-Identifier: GPL-3.0-or-later
// Registers of samples of both types, for simd_loops.h.
#pragma once

#include <cstdint>
#ifdef WIFORCE_X86
#include <immintrin.h>
#endif

// Orders of the numbers of two registers, for the first register of the result and the
// last one. Pairs: one number of each in turns. Quarters: four of each in turns. Halves:
// one 16-bit number of each in turns, within 16 bytes of both.
#define WIFORCE_ZIP(a, b) a, b, a + 1, b + 1, a + 2, b + 2, a + 3, b + 3
#define WIFORCE_FOUR(a) a, a + 1, a + 2, a + 3
#if WIFORCE_LANES == 4
#define WIFORCE_FIRST_PAIRS 0, 4, 1, 5
#define WIFORCE_LAST_PAIRS 2, 6, 3, 7
#define WIFORCE_FIRST_QUARTERS WIFORCE_FOUR(0)
#define WIFORCE_LAST_QUARTERS WIFORCE_FOUR(4)
#define WIFORCE_FIRST_HALVES WIFORCE_ZIP(0, 8)
#define WIFORCE_LAST_HALVES WIFORCE_ZIP(4, 12)
#elif WIFORCE_LANES == 8
#define WIFORCE_FIRST_PAIRS WIFORCE_ZIP(0, 8)
#define WIFORCE_LAST_PAIRS WIFORCE_ZIP(4, 12)
#define WIFORCE_FIRST_QUARTERS WIFORCE_FOUR(0), WIFORCE_FOUR(8)
#define WIFORCE_LAST_QUARTERS WIFORCE_FOUR(4), WIFORCE_FOUR(12)
#define WIFORCE_FIRST_HALVES WIFORCE_ZIP(0, 16), WIFORCE_ZIP(8, 24)
#define WIFORCE_LAST_HALVES WIFORCE_ZIP(4, 20), WIFORCE_ZIP(12, 28)
#else
#define WIFORCE_FIRST_PAIRS WIFORCE_ZIP(0, 16), WIFORCE_ZIP(4, 20)
#define WIFORCE_LAST_PAIRS WIFORCE_ZIP(8, 24), WIFORCE_ZIP(12, 28)
#define WIFORCE_FIRST_QUARTERS                                                           \
    WIFORCE_FOUR(0), WIFORCE_FOUR(16), WIFORCE_FOUR(4), WIFORCE_FOUR(20)
#define WIFORCE_LAST_QUARTERS                                                            \
    WIFORCE_FOUR(8), WIFORCE_FOUR(24), WIFORCE_FOUR(12), WIFORCE_FOUR(28)
#define WIFORCE_FIRST_HALVES                                                             \
    WIFORCE_ZIP(0, 32), WIFORCE_ZIP(8, 40), WIFORCE_ZIP(16, 48), WIFORCE_ZIP(24, 56)
#define WIFORCE_LAST_HALVES                                                              \
    WIFORCE_ZIP(4, 36), WIFORCE_ZIP(12, 44), WIFORCE_ZIP(20, 52), WIFORCE_ZIP(28, 60)
#endif
#if defined(__clang__) || __GNUC__ >= 12
#define WIFORCE_SHUFFLE(order, a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define WIFORCE_SHUFFLE(order, a, b, ...) __builtin_shuffle(a, b, order{ __VA_ARGS__ })
#endif

namespace gr::wiforce::kernel::WIFORCE_SIMD {

namespace {

constexpr int LANES = WIFORCE_LANES;
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

// The largest magnitude between extremes, and `most`.
template <class Lanes>
inline float largest_magnitude(Lanes low, Lanes high, int count, float most)
{
    for (int n = 0; n < count; n++)
        most = larger(larger<float>(high[n], -float(low[n])), most);
    return most;
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
        d_low = smaller(d_low, before);
        d_high = larger(d_high, before);
        for (int r = 1; r < (REPETITIONS ? REPETITIONS : count); r++) {
            const lanes value = at(x + r * width);
            sum += value;
            d_low = smaller(d_low, value);
            d_high = larger(d_high, value);
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
    void see(float x) { d_rest = larger(larger(x, -x), d_rest); }
    // The largest magnitude of all samples.
    float peak() const { return largest_magnitude(d_low, d_high, STEP, d_rest); }

private:
    lanes d_low = {};
    lanes d_high = {};
    float d_rest = 0;
};

struct sc16_samples {
    using component = std::int16_t;
    static constexpr int STEP = 2 * LANES;

    static short_lanes at(const std::int16_t* x)
    {
        return *reinterpret_cast<const short_lanes*>(x);
    }
    // Of neighbours. Adding them takes less time than to convert each.
    static integer_lanes sums_of_pairs(short_lanes x)
    {
#if WIFORCE_LANES == 4 && defined(WIFORCE_X86)
        return (integer_lanes)_mm_madd_epi16((__m128i)x, _mm_set1_epi16(1));
#elif WIFORCE_LANES == 8
        return (integer_lanes)_mm256_madd_epi16((__m256i)x, _mm256_set1_epi16(1));
#elif WIFORCE_LANES == 16
        return (integer_lanes)_mm512_madd_epi16((__m512i)x, _mm512_set1_epi16(1));
#else
        const auto both = reinterpret_cast<integer_lanes>(x);
        const auto odd =
            reinterpret_cast<integer_lanes>(reinterpret_cast<unsigned_lanes>(both) << 16);
        return (odd >> 16) + (both >> 16);
#endif
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
        short_lanes before = at(x);
        integer_lanes first = {};
        integer_lanes last = {};
        const auto add = [&](short_lanes a, short_lanes b) {
            first +=
                sums_of_pairs(WIFORCE_SHUFFLE(short_lanes, a, b, WIFORCE_FIRST_HALVES));
            last +=
                sums_of_pairs(WIFORCE_SHUFFLE(short_lanes, a, b, WIFORCE_LAST_HALVES));
        };
        const int number = REPETITIONS ? REPETITIONS : count;
        magnitudes low = {};
        magnitudes high = {};
        for (int r = 1; r < number; r++) {
            const short_lanes value = at(x + r * width);
            const short_lanes below = smaller(before, value);
            const short_lanes above = larger(before, value);
            if (r % 2) {
                add(before, value);
                see(below, above);
            }
            // Differences of 16-bit integers need all 16 bits, and no sign.
            const auto difference =
                reinterpret_cast<magnitudes>(above) - reinterpret_cast<magnitudes>(below);
            low = r == 1 ? difference : smaller(low, difference);
            high = larger(high, difference);
            before = value;
        }
        if (number % 2) {
            add(before, short_lanes{});
            see(before, before);
        }
        noise.smallest += squares(low);
        noise.largest += squares(high);
        const lanes a = scale * to_float(first);
        const lanes b = scale * to_float(last);
        *reinterpret_cast<lanes*>(out) =
            WIFORCE_SHUFFLE(integer_lanes, a, b, WIFORCE_FIRST_QUARTERS);
        *reinterpret_cast<lanes*>(out + LANES) =
            WIFORCE_SHUFFLE(integer_lanes, a, b, WIFORCE_LAST_QUARTERS);
    }

    static std::int32_t one(std::int16_t x) { return x; }
    void see(std::int16_t x) { d_rest = larger<float>(larger<float>(x, -x), d_rest); }
    // The largest magnitude of all samples.
    float peak() const { return largest_magnitude(d_low, d_high, STEP, d_rest); }

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
    float d_rest = 0;
};

} // namespace

} // namespace gr::wiforce::kernel::WIFORCE_SIMD
