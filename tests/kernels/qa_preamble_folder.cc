// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fold/preamble_folder.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

BOOST_AUTO_TEST_CASE(full_scale_is_noticed_where_samples_are_averaged)
{
    const int frames = 5;
    const preamble_folder folder(720, 64, 4);
    std::vector<sc16> x(frames * 720, sc16(32751, -32751));
    std::vector<int> found = { 7 };
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    const auto fold = [&](const auto& samples, int count) {
        folder.fold(&samples[64], count, folded.data(), noise.data(), found);
    };
    fold(x, frames);
    BOOST_TEST(found.empty());
    x[63] = x[320] = sc16(32767, -32768); // beside the averaged part of frame 0
    fold(x, frames);
    BOOST_TEST(found.empty());
    x[720 + 64] = sc16(0, 32752);
    x[3 * 720 + 319] = sc16(-32752, 0);
    fold(x, frames);
    BOOST_TEST(found == std::vector<int>({ 1, 3 }), boost::test_tools::per_element());
    std::vector<fc32> floats(frames * 720, fc32(0.999f, -0.999f));
    fold(floats, frames);
    BOOST_TEST(found.empty());
    floats[64] = fc32(2, 0); // no converter limits these
    floats[720 + 64] = fc32(0, 0.9999f);
    floats[2 * 720 + 319] = fc32(-32768 / 32767.0f, 0);
    floats[4 * 720 + 63] = fc32(1, 1); // beside the averaged part
    fold(floats, frames);
    BOOST_TEST(found == std::vector<int>({ 1, 2 }), boost::test_tools::per_element());
}

// Wherever it lies among the samples that are averaged, also behind those that fill the
// processor's registers.
BOOST_DATA_TEST_CASE(a_frame_with_a_value_that_is_not_finite_has_no_noise,
                     data::make({ 17, 64 }) * data::make({ 1, 2, 3, 4 }),
                     symbol_length,
                     repetitions)
{
    const int frames = 5, length = symbol_length * (repetitions + 2);
    const preamble_folder folder(length, symbol_length, repetitions, symbol_length);
    std::vector<fc32> folded(symbol_length * frames);
    std::vector<snapshot_noise> noise(frames);
    std::vector<int> saturated;
    for (const float bad : { INFINITY, -INFINITY, NAN })
        for (int n = 0; n < length; n++) {
            std::vector<fc32> x(frames * length, fc32(0.1f, -0.2f));
            x[3 * length + n] = n % 2 ? fc32(bad, 0) : fc32(0, bad);
            x[4 * length + symbol_length] = 1; // full scale
            folder.fold(
                &x[symbol_length], frames, folded.data(), noise.data(), saturated);
            const bool averaged =
                n >= symbol_length && n < symbol_length * (repetitions + 1);
            for (int frame = 0; frame < frames; frame++)
                BOOST_TEST(std::isnan(noise[frame].largest) == (averaged && frame == 3));
            BOOST_TEST(saturated == std::vector<int>({ 4 }),
                       boost::test_tools::per_element());
        }
}

BOOST_DATA_TEST_CASE(finite_samples_whose_mean_is_infinite_have_no_noise,
                     data::make({ 1, 2, 4 }),
                     repetitions)
{
    const preamble_folder folder(64 * repetitions, 0, repetitions);
    const std::vector<fc32> x(64 * repetitions, fc32(3e38f, -3e38f));
    std::vector<fc32> folded(64);
    snapshot_noise noise;
    std::vector<int> saturated;
    folder.fold(x.data(), 1, folded.data(), &noise, saturated);
    BOOST_TEST(std::isnan(noise.largest) == (repetitions > 1));
}

// Frames of which a converter of 12 bits, or an amplifier, limits the largest sample.
BOOST_DATA_TEST_CASE(samples_limited_below_full_scale_are_noticed,
                     data::make({ 0.0, 0.3, 2.0, 50.0 }) * data::make({ false, true }),
                     noise_codes,
                     limited)
{
    const int frames = 11;
    std::mt19937 random(5);
    std::normal_distribution<double> normal;
    std::vector<double> symbol(128);
    for (auto& part : symbol)
        part = 500 * normal(random);
    symbol[37] = 2500;
    symbol[90] = -2300;
    std::vector<sc16> codes(frames * 720);
    std::vector<fc32> floats(codes.size());
    const auto received = [&](int part) {
        const double value = std::round(symbol[part] + noise_codes * normal(random));
        return limited ? std::clamp(value, -2048.0, 2047.0) : value;
    };
    for (std::size_t n = 0; n < codes.size(); n++) {
        const int part = 2 * (n % 720 % 64);
        codes[n] = sc16(received(part), received(part + 1));
        floats[n] = fc32(codes[n].real(), codes[n].imag()) * 1e-4f;
    }
    const preamble_folder folder(720, 64, 4);
    std::vector<int> found;
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    // Without noise of some codes every sample has one value, limited or not.
    const std::size_t expected = limited && noise_codes >= 2 ? frames : 0;
    folder.fold(&codes[64], frames, folded.data(), noise.data(), found);
    BOOST_TEST(found.size() == expected);
    folder.fold(&floats[64], frames, folded.data(), noise.data(), found);
    BOOST_TEST(found.size() == expected);
    folder.fold(&codes[64], 1, folded.data(), noise.data(), found);
    BOOST_TEST(found.empty()); // too few to tell
}
