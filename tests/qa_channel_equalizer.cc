// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/channel_equalizer.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <random>
#include <stdexcept>

using namespace gr::wiforce::kernel;

BOOST_AUTO_TEST_CASE(each_bin_is_multiplied_by_its_factor)
{
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    std::vector<std::complex<double>> factors(FFT_LENGTH);
    std::vector<fc32> spectrum(FFT_LENGTH), channel(FFT_LENGTH);
    for (int k = 0; k < FFT_LENGTH; k++) {
        factors[k] = k % 5 ? std::complex<double>(normal(random), normal(random)) : 0;
        spectrum[k] = fc32(normal(random), normal(random));
    }
    channel_equalizer(factors).equalize(spectrum.data(), channel.data());
    for (int k = 0; k < FFT_LENGTH; k++)
        BOOST_TEST(std::abs(std::complex<double>(channel[k]) -
                            factors[k] * std::complex<double>(spectrum[k])) < 2e-6);
}

BOOST_AUTO_TEST_CASE(other_than_64_finite_factors_are_refused)
{
    std::vector<std::complex<double>> factors(FFT_LENGTH, 1.0);
    factors[9] = std::nan("");
    BOOST_CHECK_THROW(channel_equalizer{ factors }, std::invalid_argument);
    factors.pop_back();
    BOOST_CHECK_THROW(channel_equalizer{ factors }, std::invalid_argument);
}
