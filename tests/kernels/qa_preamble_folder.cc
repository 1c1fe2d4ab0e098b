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

namespace {

// What a folder gives of frames.
struct folding {
    std::vector<fc32> folded;
    std::vector<snapshot_noise> noise;
    std::vector<int> saturated = { 7 };

    template <class Sample>
    folding(const preamble_folder& folder, const std::vector<Sample>& samples)
        : folded(samples.size() / folder.frame_length() * folder.symbol_length()),
          noise(samples.size() / folder.frame_length())
    {
        folder.fold(&samples[folder.first_averaged()],
                    noise.size(),
                    folded.data(),
                    noise.data(),
                    saturated);
    }

    // Of samples in units of full scale.
    template <class Sample>
    void check(const preamble_folder& folder,
               const std::vector<Sample>& samples,
               double unit,
               double tolerance) const
    {
        const int length = folder.symbol_length(),
                  repetitions = folder.averaged_length() / length;
        for (std::size_t frame = 0; frame < noise.size(); frame++) {
            double smallest = 0, largest = 0;
            for (int n = 0; n < 2 * length; n++) {
                const auto* const first =
                    reinterpret_cast<const typename Sample::value_type*>(
                        &samples[frame * folder.frame_length() +
                                 folder.first_averaged()]);
                double sum = first[n], low = repetitions > 1 ? 1e300 : 0, high = 0;
                for (int r = 1; r < repetitions; r++) {
                    const double value = first[2 * r * length + n];
                    const double step = unit * (value - first[2 * (r - 1) * length + n]);
                    sum += value;
                    low = std::min(low, step * step);
                    high = std::max(high, step * step);
                }
                smallest += low / (2 * length);
                largest += high / (2 * length);
                const auto* const found =
                    reinterpret_cast<const float*>(&folded[frame * length]);
                BOOST_TEST(std::abs(found[n] - unit * sum / repetitions) <= tolerance);
            }
            BOOST_TEST(std::abs(noise[frame].smallest - smallest) <= 1e-5 * smallest);
            BOOST_TEST(std::abs(noise[frame].largest - largest) <= 1e-5 * largest);
        }
    }
};

// The default symbol, the shortest, and two that do not fill the registers.
const auto lengths = data::make({ 64, 16, 17, 125 });

} // namespace

BOOST_DATA_TEST_CASE(noise_is_found_under_a_strong_path,
                     data::make({ 1, 2, 3, 4, 5 }) * lengths,
                     repetitions,
                     length)
{
    const preamble_folder folder(length * repetitions + 21, 11, repetitions, length);
    std::mt19937 random(8);
    std::normal_distribution<float> normal;
    std::vector<fc32> path(length), x(3 * folder.frame_length());
    for (fc32& value : path) // 60 dB above the noise
        value = fc32(normal(random), normal(random)) * 1000.0f;
    for (std::size_t i = 0; i < x.size(); i++) {
        const std::size_t place = i % folder.frame_length() + 10 * length - 11;
        x[i] = path[place % length] + fc32(normal(random), normal(random));
    }
    folding(folder, x).check(folder, x, 1, 1e-3);
}

BOOST_DATA_TEST_CASE(integers_are_folded_exactly,
                     data::make({ 1, 2, 4, 5 }) * lengths,
                     repetitions,
                     length)
{
    const preamble_folder folder(length * repetitions + 21, 11, repetitions, length);
    std::mt19937 random(2);
    std::uniform_int_distribution<int> uniform(-32768, 32767);
    std::vector<sc16> x(7 * folder.frame_length());
    for (sc16& value : x)
        value = sc16(uniform(random), uniform(random));
    std::fill_n(x.begin(), folder.frame_length(), sc16(-32768, -32768));
    folding(folder, x).check(folder, x, 1 / 32768.0, 6e-8);
}

BOOST_DATA_TEST_CASE(full_scale_is_noticed_wherever_it_is_averaged,
                     data::make({ 1, 2, 3, 4 }) * data::make({ 64, 17 }),
                     repetitions,
                     length)
{
    const preamble_folder folder(length * repetitions + 21, 11, repetitions, length);
    const int frame = folder.frame_length();
    for (int n = 0; n < 3 * frame; n++)
        for (const int value : { 32752, 32767, -32752, -32768 }) {
            std::vector<sc16> x(3 * frame, sc16(7, 7));
            x[n] = n % 2 ? sc16(value, 7) : sc16(7, value);
            const int place = n % frame - 11;
            std::vector<int> expected;
            if (place >= 0 && place < folder.averaged_length())
                expected.push_back(n / frame);
            if (folding(folder, x).saturated != expected)
                BOOST_ERROR(n << ": " << value);
        }
}

BOOST_AUTO_TEST_CASE(full_scale_of_floats_is_what_a_converter_may_give)
{
    const preamble_folder folder(720, 64, 4);
    const auto found = [&](const auto& samples) {
        return folding(folder, samples).saturated;
    };
    BOOST_TEST(found(std::vector<sc16>(5 * 720, sc16(32751, -32751))).empty());
    std::vector<fc32> floats(5 * 720, fc32(0.999f, -0.999f));
    BOOST_TEST(found(floats).empty());
    floats[64] = fc32(2, 0); // no converter limits these
    floats[720 + 64] = fc32(0, 0.9999f);
    floats[2 * 720 + 319] = fc32(-32768 / 32767.0f, 0);
    floats[4 * 720 + 63] = fc32(1, 1); // beside the averaged part
    BOOST_TEST(found(floats) == std::vector<int>({ 1, 2 }),
               boost::test_tools::per_element());
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
    for (const float bad : { INFINITY, -INFINITY, NAN })
        for (int n = 0; n < length; n++) {
            std::vector<fc32> x(frames * length, fc32(0.1f, -0.2f));
            x[3 * length + n] = n % 2 ? fc32(bad, 0) : fc32(0, bad);
            x[4 * length + symbol_length] = 1; // full scale
            const folding found(folder, x);
            const bool averaged =
                n >= symbol_length && n < symbol_length * (repetitions + 1);
            for (int frame = 0; frame < frames; frame++)
                BOOST_TEST(std::isnan(found.noise[frame].largest) ==
                           (averaged && frame == 3));
            BOOST_TEST(found.saturated == std::vector<int>({ 4 }),
                       boost::test_tools::per_element());
        }
}

BOOST_DATA_TEST_CASE(finite_samples_whose_mean_is_infinite_have_no_noise,
                     data::make({ 1, 2, 4 }),
                     repetitions)
{
    const preamble_folder folder(64 * repetitions, 0, repetitions);
    const std::vector<fc32> x(64 * repetitions, fc32(3e38f, -3e38f));
    BOOST_TEST(std::isnan(folding(folder, x).noise[0].largest) == (repetitions > 1));
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
    // Without noise of some codes every sample has one value, limited or not.
    const std::size_t expected = limited && noise_codes >= 2 ? frames : 0;
    BOOST_TEST(folding(folder, codes).saturated.size() == expected);
    BOOST_TEST(folding(folder, floats).saturated.size() == expected);
    codes.resize(720); // too few to tell
    BOOST_TEST(folding(folder, codes).saturated.empty());
}
