// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/channel_equalizer.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <random>
#include <stdexcept>

using namespace gr::wiforce::kernel;
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

double largest_error(const std::vector<fc32>& product,
                     const std::vector<fc32>& x,
                     const std::complex<double>* y)
{
    double error = 0;
    for (int k = 0; k < FFT_LENGTH; k++)
        error = std::max(error,
                         std::abs(std::complex<double>(product[k]) -
                                  std::complex<double>(x[k]) * y[k]));
    return error;
}

const auto noise = random_table(FFT_LENGTH, 1);
const std::vector<fc32> x(noise.begin(), noise.end());

} // namespace

BOOST_AUTO_TEST_CASE(each_bin_is_multiplied_by_its_factor)
{
    const auto factors = random_table(FFT_LENGTH, 2);
    std::vector<fc32> channel(FFT_LENGTH);
    channel_equalizer(factors, 1, {}).equalize(x.data(), channel.data());
    BOOST_TEST(largest_error(channel, x, factors.data()) < 2e-6);
}

BOOST_AUTO_TEST_CASE(each_row_is_turned_by_its_own_rotation)
{
    const int rows = 3;
    const auto rotation = random_table(rows * FFT_LENGTH, 3);
    const channel_equalizer equalizer(random_table(FFT_LENGTH, 2), rows, rotation);
    std::vector<fc32> turned(FFT_LENGTH);
    for (int row = 0; row < rows; row++) {
        equalizer.rotate(row, x.data(), turned.data());
        BOOST_TEST(largest_error(turned, x, &rotation[row * FFT_LENGTH]) < 2e-6);
    }
}

BOOST_AUTO_TEST_CASE(without_a_rotation_samples_stay_as_they_are)
{
    std::vector<fc32> turned(FFT_LENGTH);
    channel_equalizer(random_table(FFT_LENGTH, 2), 5, {})
        .rotate(4, x.data(), turned.data());
    BOOST_TEST((turned == x));
}

BOOST_AUTO_TEST_CASE(bad_factors_rows_and_rotations_are_refused)
{
    const auto factors = random_table(FFT_LENGTH, 2);
    auto not_a_number = factors;
    not_a_number[9] = std::nan("");
    using bad = std::invalid_argument;
    BOOST_CHECK_THROW(channel_equalizer(not_a_number, 1, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(random_table(63, 2), 1, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 0, {}), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 2, factors), bad);
    BOOST_CHECK_THROW(channel_equalizer(factors, 1, not_a_number), bad);
}
