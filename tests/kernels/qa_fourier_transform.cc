// SPDX-License-Identifier: GPL-3.0-or-later
// The Fourier transform of builds without FFTW, against the sum that defines it.
#include <boost/test/unit_test.hpp>

// In place of the one that the library was built with.
#include <kernel/fourier/fourier_transform.cc>

#include <cmath>
#include <complex>
#include <random>
#include <vector>

using namespace gr::wiforce::kernel;

BOOST_AUTO_TEST_CASE(transform_of_any_length_is_the_defining_sum)
{
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    // Lengths of channel estimates, mixed factors, a prime and one value.
    for (const int length : { 1, 2, 31, 60, 64, 90, 625 }) {
        std::vector<fc32> x(length);
        for (fc32& value : x)
            value = { normal(random), normal(random) };
        fourier_transform transform(length);
        std::copy(x.begin(), x.end(), transform.input());
        const fc32* const found = transform.execute();
        for (int k = 0; k < length; k++) {
            std::complex<double> sum = 0.0;
            for (int n = 0; n < length; n++)
                sum += std::complex<double>(x[n]) *
                       std::polar(1.0, -2.0 * M_PI * (k * n % length) / length);
            // Half a unit in the last place of a float in each part, of values up to 128.
            BOOST_TEST(std::abs(std::complex<double>(found[k]) - sum) < 1e-5);
        }
    }
}
