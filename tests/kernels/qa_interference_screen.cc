// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/interference_screen.h"
#include "kernel/fold/preamble_folder.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <cmath>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

constexpr int FRAME = 4 * DEFAULT_SYMBOL_LENGTH;

// Groups shorter than those of captures, samples with noise below the converter's steps,
// and snapshots that are not finite: bursts are marked, and edges of a tag apart from
// them are not.
BOOST_DATA_TEST_CASE(bursts_are_marked_where_they_are,
                     data::make({ 40, 125, 125, 40 }) ^
                         data::make({ 0.0f, 0.0f, 0.05f, 0.0f }) ^
                         data::make({ false, false, false, true }),
                     length,
                     step,
                     with_nan)
{
    std::mt19937 random{ 3 };
    std::normal_distribution<float> normal;
    const auto draw = [&](float level) {
        return level * fc32(normal(random), normal(random));
    };
    std::vector<fc32> room(DEFAULT_SYMBOL_LENGTH), tag(DEFAULT_SYMBOL_LENGTH);
    for (int k = 0; k < DEFAULT_SYMBOL_LENGTH; k++) {
        room[k] = draw(3.0f);
        tag[k] = draw(0.1f);
    }
    const preamble_folder folder(FRAME, 0, 4);
    interference_screen screen(length);
    phase_group group(length);
    std::vector<fc32> x(FRAME * length);
    std::vector<int> saturated;
    int hit = 0, found = 0, apart = 0;
    for (int index = 0; index < 12; index++) {
        std::vector<int> hits(length + 2); // with one more at each end
        for (int n = 0; n < length; n++) {
            hits[n + 1] = random() % 20 == 0;
            const int edge = random() % 8; // repetition, or none
            for (int i = 0; i < FRAME; i++) {
                const int k = i % DEFAULT_SYMBOL_LENGTH;
                const bool on = (n / 3 % 2) ^ (i / DEFAULT_SYMBOL_LENGTH > edge);
                fc32& value = x[FRAME * n + i];
                value = room[k] + (on ? tag[k] : 0) + draw(hits[n + 1] ? 0.1f : 0.01f);
                if (step > 0)
                    value = step * fc32(std::round(value.real() / step),
                                        std::round(value.imag() / step));
            }
        }
        if (with_nan) {
            x[FRAME * (length - 1)] = NAN;
            hits[length] = 0;
        }
        group.clear();
        folder.fold(x.data(), length, group.reserve(0), group.noise(), saturated);
        group.accept(length);
        group.finish();
        BOOST_TEST(group.missing() == with_nan);
        const auto& marks = screen.examine(group);
        for (int n = 0; n < length; n++) {
            hit += hits[n + 1];
            found += hits[n + 1] && marks[n];
            // An edge beside a burst may be a part of it.
            apart += marks[n] && !(hits[n] || hits[n + 1] || hits[n + 2]);
        }
    }
    BOOST_TEST(hit > 15);
    BOOST_TEST(found >= hit - 1); // of the first group
    BOOST_TEST(apart == 0);
}
