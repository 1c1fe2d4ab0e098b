// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/timing/frame_watch.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <limits>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

constexpr int LENGTH = 90;

// A stream of frames, of which samples can be lost, and what watches it.
class air
{
public:
    explicit air(float noise) : d_noise(noise), d_frame(LENGTH)
    {
        for (int i = 0; i < LENGTH / 2; i++)
            d_frame[i] = { d_normal(d_random), d_normal(d_random) };
    }

    // Takes the samples up to so many before the next decision.
    void take(std::uint64_t before = 0)
    {
        for (; d_position + before < d_watch.decision(); d_position++) {
            const fc32 noise(d_normal(d_random), d_normal(d_random));
            const fc32 sample = d_frame[d_place++ % LENGTH] + d_noise * noise + constant;
            d_watch.take(&sample, 1, d_position);
        }
    }

    // Follows the stream for so many decisions and expects these shifts on the way.
    void follow(int decisions, const std::vector<int>& expected = {})
    {
        std::vector<int> found;
        while (decisions-- > 0) {
            take();
            const int shift = d_watch.decide();
            if (shift == 0)
                continue;
            found.push_back(shift);
            d_position += LENGTH - shift;
            d_watch.restart(d_position);
        }
        BOOST_TEST(found == expected, boost::test_tools::per_element());
    }

    void lose(int samples) { d_place += samples; }
    // As preambles do.
    void repeat_five_times()
    {
        for (int i = 0; i < LENGTH / 2; i++)
            d_frame[i] = d_frame[i % (LENGTH / 10)];
    }
    void change_channel()
    {
        for (fc32& value : d_frame)
            value =
                std::norm(value) > 0 ? fc32(d_normal(d_random), d_normal(d_random)) : 0;
    }

    fc32 constant = 0;

private:
    const float d_noise;
    std::mt19937 d_random{ 3 };
    std::normal_distribution<float> d_normal;
    std::vector<fc32> d_frame;
    std::uint64_t d_place = 0, d_position = 0;
    frame_watch d_watch{ LENGTH, 0 };
};

} // namespace

BOOST_DATA_TEST_CASE(frames_that_stay_are_left_alone, data::make({ 0.0f, 0.5f, 20.0f }))
{
    air(sample).follow(30);
}

BOOST_DATA_TEST_CASE(lost_samples_are_found_but_for_whole_frames,
                     data::make({ 1, 7, 45, 89, 90, 137 }))
{
    air stream(0.7f);
    stream.follow(2);
    stream.lose(sample);
    const bool whole = sample % LENGTH == 0;
    stream.follow(6, std::vector<int>(!whole, LENGTH - sample % LENGTH));
    stream.lose(5); // and again
    stream.follow(6, { LENGTH - 5 });
}

BOOST_DATA_TEST_CASE(a_loss_while_frames_are_averaged_is_found, data::xrange(0, 17))
{
    air stream(0.3f);
    stream.follow(3);
    stream.take(sample * LENGTH); // frames before the end of what is averaged
    stream.lose(11);
    stream.follow(8, { LENGTH - 11 });
}

BOOST_AUTO_TEST_CASE(a_loss_of_one_repetition_of_the_preamble_is_found)
{
    air stream(0.1f);
    stream.repeat_five_times();
    stream.follow(3);
    stream.lose(LENGTH / 10);
    stream.follow(6, { LENGTH - LENGTH / 10 });
}

BOOST_DATA_TEST_CASE(another_constant_or_channel_hides_no_loss_and_makes_none,
                     data::make({ false, true }))
{
    air stream(0.3f);
    stream.follow(2);
    if (sample)
        stream.change_channel();
    else
        stream.constant = { 30, -40 };
    stream.follow(6);
    stream.lose(11);
    stream.follow(6, { LENGTH - 11 });
}

BOOST_AUTO_TEST_CASE(
    samples_before_the_grid_and_values_that_are_no_numbers_count_for_nothing)
{
    const fc32 none(std::numeric_limits<float>::quiet_NaN(), 0);
    frame_watch watch(LENGTH, 13);
    BOOST_TEST(watch.decision() % LENGTH == 13);
    for (std::uint64_t i = 0; i < watch.decision(); i++)
        watch.take(&none, 1, i);
    BOOST_TEST(watch.decide() == 0);
}
