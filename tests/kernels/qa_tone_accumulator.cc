// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/doppler_transform.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

// Also where it is the first snapshot, the reference of the sums.
BOOST_DATA_TEST_CASE(rejected_snapshots_count_as_little_as_missing_ones,
                     data::make({ 0, 40 }),
                     first)
{
    constexpr int LENGTH = 75; // two whole blocks and a part of one
    constexpr int WIDTH = DEFAULT_SYMBOL_LENGTH, ROWS = 4, LAST = 60;
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    std::vector<complex> weights(ROWS * LENGTH);
    for (auto& weight : weights)
        weight = { normal(random), normal(random) };
    std::vector<fc32> h(LENGTH * WIDTH);
    for (auto& value : h)
        value = fc32(normal(random) + 1, normal(random) - 1);
    phase_group rejecting(LENGTH), missing(LENGTH);
    std::vector<std::uint8_t> marks(LENGTH);
    for (int n = 0; n < LENGTH; n++) {
        marks[n] = n == first || n == LAST;
        for (auto* group : { &rejecting, &missing }) {
            if (marks[n] && group == &missing)
                continue;
            fc32* const slot = group->reserve(n);
            std::copy_n(&h[n * WIDTH], WIDTH, slot);
            slot[n % WIDTH] += marks[n] ? 1e4f : 0.0f;
            group->accept(1);
        }
    }
    rejecting.finish();
    missing.finish();
    rejecting.reject(marks);
    tone_accumulator accumulator(weights, LENGTH);
    std::vector<fc32> found(ROWS * WIDTH), expected(ROWS * WIDTH);
    accumulator.transform(rejecting, found.data());
    accumulator.transform(missing, expected.data());
    BOOST_TEST(found == expected, boost::test_tools::per_element());
    BOOST_TEST(rejecting.rejected() == 2);
    BOOST_TEST(rejecting.missing() == 0);
    BOOST_TEST(!rejecting.is_complete());
    BOOST_TEST(rejecting.present() == LENGTH - 2);
}
