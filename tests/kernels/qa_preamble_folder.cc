// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fold/preamble_folder.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

struct layout {
    int frame_length, first_averaged, repetitions;
};
std::ostream& operator<<(std::ostream& out, const layout& l)
{
    return out << l.frame_length << '/' << l.first_averaged << '/' << l.repetitions;
}
const std::vector<layout> layouts = {
    { 720, 64, 4 }, { 320, 64, 4 }, { 720, 192, 2 }, { 64, 0, 1 }, { 333, 13, 5 }
};
const std::vector<layout> bad_layouts = {
    { 319, 64, 4 }, { 720, -1, 4 }, { 720, 64, 0 }, { 0, 0, 1 }, { 720, 465, 4 }
};

template <class Sample>
std::complex<double> mean(const std::vector<Sample>& x, const layout& l, int frame, int n)
{
    std::complex<double> sum = 0;
    for (int r = 0; r < l.repetitions; r++) {
        const auto& v = x[frame * l.frame_length + l.first_averaged + 64 * r + n];
        sum += std::complex<double>(v.real(), v.imag());
    }
    return sum / double(l.repetitions);
}

} // namespace

BOOST_DATA_TEST_CASE(floats_fold_to_their_mean, data::make(layouts))
{
    const int frames = 9;
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    // NaN outside the averaged part: it must never be read into a result.
    const float nan = std::numeric_limits<float>::quiet_NaN();
    std::vector<fc32> x(frames * sample.frame_length, fc32(nan, nan));
    for (int f = 0; f < frames; f++)
        for (int i = 0; i < 64 * sample.repetitions; i++)
            x[f * sample.frame_length + sample.first_averaged + i] =
                fc32(normal(random), normal(random));

    const preamble_folder folder(
        sample.frame_length, sample.first_averaged, sample.repetitions);
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    folder.fold(&x[sample.first_averaged], frames, folded.data(), noise.data());

    // Sums of a few values near 1: some ulp of float.
    for (int f = 0; f < frames; f++)
        for (int n = 0; n < 64; n++)
            BOOST_TEST(std::abs(std::complex<double>(folded[64 * f + n]) -
                                mean(x, sample, f, n)) < 1e-6);
}

BOOST_DATA_TEST_CASE(sc16_folds_exactly_even_at_full_scale, data::make(layouts))
{
    const int frames = 9;
    std::mt19937 random(2);
    std::uniform_int_distribution<int> uniform(-32768, 32767);
    std::vector<sc16> x(frames * sample.frame_length);
    for (auto& v : x)
        v = sc16(uniform(random), uniform(random));
    std::fill_n(x.begin(), sample.frame_length, sc16(-32768, 32767));

    const preamble_folder folder(
        sample.frame_length, sample.first_averaged, sample.repetitions);
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    folder.fold(&x[sample.first_averaged], frames, folded.data(), noise.data());

    const bool power_of_two = (sample.repetitions & (sample.repetitions - 1)) == 0;
    for (int f = 0; f < frames; f++)
        for (int n = 0; n < 64; n++) {
            const auto want = mean(x, sample, f, n) / 32768.0;
            const auto error = std::abs(std::complex<double>(folded[64 * f + n]) - want);
            BOOST_TEST(error <= (power_of_two ? 0.0 : 1e-7 * std::abs(want)));
        }
}

BOOST_AUTO_TEST_CASE(full_scale_is_noticed_where_samples_are_averaged)
{
    const int frames = 5;
    const preamble_folder folder(720, 64, 4);
    std::vector<sc16> x(frames * 720, sc16(32751, -32751));
    std::vector<int> found = { 7 };
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    const auto fold = [&](const auto& samples, int count) {
        folder.fold(&samples[64], count, folded.data(), noise.data(), &found);
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
    fold(std::vector<fc32>(720, fc32(2, 2)), 1);
    BOOST_TEST(found.empty());
}

BOOST_DATA_TEST_CASE(a_layout_that_does_not_fit_is_refused, data::make(bad_layouts))
{
    BOOST_CHECK_THROW(
        preamble_folder(sample.frame_length, sample.first_averaged, sample.repetitions),
        std::invalid_argument);
}
