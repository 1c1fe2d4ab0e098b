// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fold/sample_loops.h"
#include "kernel/types.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

// The default symbol, the shortest, and two that do not fill the registers.
const auto widths = data::make({ 128, 32, 34, 250 });

std::vector<float> noise(std::size_t count, unsigned seed)
{
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    std::vector<float> x(count);
    for (auto& v : x)
        v = normal(random);
    return x;
}

// What the kernels give as snapshot_noise, for components in units of full scale.
template <class T>
std::pair<double, double> noise_of(
    const std::vector<T>& in, std::size_t first, int repetitions, int width, double unit)
{
    double smallest = 0, largest = 0;
    for (int n = 0; repetitions > 1 && n < width; n++) {
        std::vector<double> squares;
        for (int r = 1; r < repetitions; r++) {
            const double after = in[first + r * width + n];
            squares.push_back(
                std::pow(unit * (after - in[first + (r - 1) * width + n]), 2));
        }
        smallest += *std::min_element(squares.begin(), squares.end()) / width;
        largest += *std::max_element(squares.begin(), squares.end()) / width;
    }
    return { smallest, largest };
}

// Frames as a kernel folds them, and the noise of each.
struct folding {
    std::vector<float> folded, levels;
    float peak = 0;

    template <class T>
    folding(const std::vector<T>& in,
            std::size_t stride,
            int repetitions,
            int width,
            float scale)
        : folded(in.size() / stride * width), levels(in.size() / stride * 2)
    {
        const repeated_symbols<T> symbols{
            in.data(), stride, in.size() / stride, repetitions, width
        };
        peak = fold_samples(symbols, scale, folded.data(), levels.data());
    }

    template <class T>
    void
    check_noise(const std::vector<T>& in, int repetitions, int width, double unit) const
    {
        for (std::size_t f = 0; 2 * f < levels.size(); f++) {
            const std::size_t first = 2 * in.size() / levels.size() * f;
            const auto [smallest, largest] =
                noise_of(in, first, repetitions, width, unit);
            BOOST_TEST(std::abs(levels[2 * f] - smallest) <= 1e-5 * smallest);
            BOOST_TEST(std::abs(levels[2 * f + 1] - largest) <= 1e-5 * largest);
        }
    }
};

} // namespace

BOOST_DATA_TEST_CASE(fold_fc32_finds_noise_under_a_strong_path,
                     data::make({ 1, 2, 3, 4, 5 }) * widths,
                     repetitions,
                     width)
{
    const std::size_t frames = 3, stride = width * repetitions + 42;
    auto in = noise(frames * stride, 8);
    const auto path = noise(width, 9);
    for (std::size_t i = 0; i < in.size(); i++) // 60 dB above the noise
        in[i] += 1000 * path[i % stride % width];
    const folding found(in, stride, repetitions, width, 0.5f / repetitions);
    found.check_noise(in, repetitions, width, 0.5);
}

BOOST_DATA_TEST_CASE(fold_sc16_is_exact,
                     data::make({ 1, 2, 4, 5 }) * widths,
                     repetitions,
                     width)
{
    const std::size_t frames = 7, stride = width * repetitions + 42;
    std::mt19937 random(2);
    std::uniform_int_distribution<int> uniform(-32768, 32767);
    std::vector<std::int16_t> in(frames * stride);
    for (auto& v : in)
        v = uniform(random);
    std::fill_n(in.begin(), width * repetitions, -32768);
    const folding found(in, stride, repetitions, width, 0.5f);
    for (std::size_t f = 0; f < frames; f++)
        for (int n = 0; n < width; n++) {
            int sum = 0;
            for (int r = 0; r < repetitions; r++)
                sum += in[f * stride + r * width + n];
            BOOST_TEST(found.folded[f * width + n] == 0.5f * sum);
        }
    found.check_noise(in, repetitions, width, 0.5 * repetitions);
}

BOOST_DATA_TEST_CASE(fold_sc16_returns_the_largest_magnitude,
                     data::make({ 1, 2, 3, 4 }) * data::make({ 128, 34 }),
                     repetitions,
                     width)
{
    const int frames = 3, stride = repetitions * width + 42;
    for (int n = 0; n < stride * frames; n++)
        for (const int value : { 32752, 32767, -32752, -32768 }) {
            std::vector<std::int16_t> x(stride * frames, 7);
            x[n] = value;
            const bool looked_at = n % stride < repetitions * width;
            const float peak = folding(x, stride, repetitions, width, 1).peak;
            if (peak != (looked_at ? std::abs(value) : 7))
                BOOST_ERROR(n << ": " << value << " of " << peak);
        }
}
