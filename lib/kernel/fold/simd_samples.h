// SPDX-License-Identifier: GPL-3.0-or-later
// Registers of samples of both types, for simd_loops.h.
#pragma once

#include <cstdint>

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

} // namespace

} // namespace gr::wiforce::kernel::WIFORCE_SIMD
