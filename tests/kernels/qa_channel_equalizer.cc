// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fourier/channel_equalizer.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <random>
#include <stdexcept>

using namespace gr::wiforce::kernel;

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using table = std::vector<std::complex<double>>;

namespace {

table random_table(std::size_t count, unsigned seed)
{
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    table values(count);
    for (auto& v : values)
        v = { normal(random), normal(random) };
    return values;
}

// factors[k] sum_n samples[n] rotation[n] exp(-2 pi j k n / 64), in double.
table plain_channel(const std::vector<fc32>& samples,
                    const std::complex<double>* rotation,
                    const table& factors)
{
    table channel(FFT_LENGTH);
    for (int k = 0; k < FFT_LENGTH; k++) {
        for (int n = 0; n < FFT_LENGTH; n++)
            channel[k] += std::complex<double>(samples[n]) * rotation[n] *
                          std::polar(1.0, -2 * M_PI * k * n / FFT_LENGTH);
        channel[k] *= factors[k];
    }
    return channel;
}

// Of the largest value.
double largest_error(const std::vector<fc32>& channel, const table& want)
{
    double error = 0, largest = 0;
    for (int k = 0; k < FFT_LENGTH; k++) {
        error = std::max(error, std::abs(std::complex<double>(channel[k]) - want[k]));
        largest = std::max(largest, std::abs(want[k]));
    }
    return error / largest;
}

const auto noise = random_table(FFT_LENGTH, 1);
const std::vector<fc32> x(noise.begin(), noise.end());
const table ones(FFT_LENGTH, 1.0);
constexpr double FLOAT_ROUNDING = 1e-6;

} // namespace

BOOST_AUTO_TEST_CASE(equalizer_without_rotation_gives_the_spectrum_times_the_factors)
{
    const auto factors = random_table(FFT_LENGTH, 2);
    std::vector<fc32> channel(FFT_LENGTH);
    channel_equalizer(factors, 5, {}).equalize(4, x.data(), channel.data());
    BOOST_TEST(largest_error(channel, plain_channel(x, ones.data(), factors)) <
               FLOAT_ROUNDING);
}

BOOST_AUTO_TEST_CASE(equalizer_of_several_rows_rotates_each_by_its_own)
{
    const int rows = 3;
    const auto rotation = random_table(rows * FFT_LENGTH, 3);
    const auto factors = random_table(FFT_LENGTH, 2);
    channel_equalizer equalizer(factors, rows, rotation);
    std::vector<fc32> channel(FFT_LENGTH);
    for (int row = 0; row < rows; row++) {
        equalizer.equalize(row, x.data(), channel.data());
        const auto want = plain_channel(x, &rotation[row * FFT_LENGTH], factors);
        BOOST_TEST(largest_error(channel, want) < FLOAT_ROUNDING);
    }
}

BOOST_AUTO_TEST_CASE(equalizer_may_write_where_it_reads)
{
    std::vector<fc32> apart(FFT_LENGTH), in_place = x;
    channel_equalizer equalizer(random_table(FFT_LENGTH, 2));
    equalizer.equalize(0, x.data(), apart.data());
    equalizer.equalize(0, in_place.data(), in_place.data());
    BOOST_TEST((apart == in_place));
}

BOOST_AUTO_TEST_CASE(bad_factors_rows_and_rotations_are_refused)
{
    const auto factors = random_table(FFT_LENGTH, 2);
    auto not_a_number = factors;
    not_a_number[9] = std::nan("");
    using bad = std::invalid_argument;
    BOOST_CHECK_THROW(channel_equalizer(not_a_number, 1, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(random_table(15, 2), 1, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(random_table(4097, 2), 1, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 0, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 2, factors), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 1, not_a_number), bad);
}
