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

// A stream of frames, of which samples can be lost.
class air
{
public:
    explicit air(float noise) : d_noise(noise), d_frame(LENGTH)
    {
        for (int i = 0; i < LENGTH / 2; i++)
            d_frame[i] = { d_normal(d_random), d_normal(d_random) };
    }

    fc32 next()
    {
        const fc32 noise(d_normal(d_random), d_normal(d_random));
        return d_frame[d_place++ % LENGTH] + d_noise * noise + constant;
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
    std::uint64_t d_place = 0;
};

// Follows the stream for so many decisions; returns the shifts found on the way.
std::vector<int>
follow(frame_watch& watch, air& stream, std::uint64_t& position, int decisions)
{
    std::vector<int> found;
    while (decisions-- > 0) {
        for (; position < watch.decision(); position++) {
            const fc32 sample = stream.next();
            watch.take(&sample, 1, position);
        }
        const int shift = watch.decide();
        if (shift != 0) {
            found.push_back(shift);
            position += LENGTH - shift;
            watch.restart(position);
        }
    }
    return found;
}

template <class Change>
void finds_no_loss_but_the_one_after(const Change& change)
{
    air stream(0.3f);
    frame_watch watch(LENGTH, 0);
    std::uint64_t position = 0;
    follow(watch, stream, position, 2);
    change(stream);
    BOOST_TEST(follow(watch, stream, position, 6).empty());
    stream.lose(11);
    BOOST_TEST(follow(watch, stream, position, 6) == std::vector<int>{ LENGTH - 11 },
               boost::test_tools::per_element());
}

} // namespace

BOOST_DATA_TEST_CASE(frames_that_stay_are_left_alone, data::make({ 0.0f, 0.5f, 20.0f }))
{
    air stream(sample);
    frame_watch watch(LENGTH, 0);
    std::uint64_t position = 0;
    BOOST_TEST(follow(watch, stream, position, 30).empty());
}

BOOST_DATA_TEST_CASE(lost_samples_are_found_but_for_whole_frames,
                     data::make({ 1, 7, 45, 89, 90, 137 }))
{
    air stream(0.7f);
    frame_watch watch(LENGTH, 0);
    std::uint64_t position = 0;
    follow(watch, stream, position, 2);
    stream.lose(sample);
    std::vector<int> expected;
    if (sample % LENGTH != 0)
        expected.push_back(LENGTH - sample % LENGTH);
    BOOST_TEST(follow(watch, stream, position, 6) == expected,
               boost::test_tools::per_element());
    stream.lose(5); // and again
    BOOST_TEST(follow(watch, stream, position, 6) == std::vector<int>{ LENGTH - 5 },
               boost::test_tools::per_element());
}

BOOST_DATA_TEST_CASE(a_loss_while_frames_are_averaged_is_found, data::xrange(0, 17))
{
    air stream(0.3f);
    frame_watch watch(LENGTH, 0);
    std::uint64_t position = 0;
    follow(watch, stream, position, 3);
    // by frames before the end of what is averaged
    for (; position + sample * LENGTH < watch.decision(); position++) {
        const fc32 value = stream.next();
        watch.take(&value, 1, position);
    }
    stream.lose(11);
    BOOST_TEST(follow(watch, stream, position, 8) == std::vector<int>{ LENGTH - 11 },
               boost::test_tools::per_element());
}

BOOST_AUTO_TEST_CASE(a_loss_of_one_repetition_of_the_preamble_is_found)
{
    air stream(0.1f);
    stream.repeat_five_times();
    frame_watch watch(LENGTH, 0);
    std::uint64_t position = 0;
    follow(watch, stream, position, 3);
    stream.lose(LENGTH / 10);
    BOOST_TEST(follow(watch, stream, position, 6) ==
                   std::vector<int>{ LENGTH - LENGTH / 10 },
               boost::test_tools::per_element());
}

BOOST_AUTO_TEST_CASE(a_constant_hides_no_loss_and_makes_none)
{
    finds_no_loss_but_the_one_after([](air& stream) { stream.constant = { 30, -40 }; });
}

BOOST_AUTO_TEST_CASE(another_channel_is_no_shift)
{
    finds_no_loss_but_the_one_after([](air& stream) { stream.change_channel(); });
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

BOOST_DATA_TEST_CASE(lost_samples_are_found_in_long_frames,
                     data::make({ 1, 4096, 8191, 20481 }))
{
    // Five repetitions of a symbol of 4096 samples, and a guard as long as it.
    constexpr int SYMBOL = 4096, FRAME = 6 * SYMBOL;
    std::mt19937 random{ 5 };
    std::normal_distribution<float> normal;
    std::vector<fc32> frame(FRAME);
    for (int i = 0; i < SYMBOL; i++)
        frame[i] = { normal(random), normal(random) };
    for (int i = SYMBOL; i < 5 * SYMBOL; i++)
        frame[i] = frame[i - SYMBOL];
    frame_watch watch(FRAME, 0);
    std::uint64_t position = 0, place = 0;
    int found = 0;
    for (int decisions = 0; decisions < 5 && found == 0; decisions++) {
        // What lies between two averages is not taken.
        const auto skipped = watch.decision() - watch.averaged_samples() - position;
        position += skipped;
        place += skipped;
        for (; position < watch.decision(); position++, place++) {
            const fc32 value = frame[place % FRAME] + 0.5f * fc32(normal(random), 0);
            watch.take(&value, 1, position);
        }
        found = watch.decide();
        if (decisions == 1)
            place += sample;
    }
    BOOST_TEST(found == FRAME - sample);
}

BOOST_AUTO_TEST_CASE(frames_too_long_to_be_searched_are_not_watched)
{
    const fc32 one(1, 0);
    frame_watch longest(frame_watch::LONGEST_FRAME, 0);
    BOOST_TEST(longest.decision() == longest.averaged_samples());
    frame_watch longer(frame_watch::LONGEST_FRAME + 1, 0);
    longer.take(&one, 1, 0);
    longer.restart(1000);
    BOOST_TEST(longer.decision() == std::numeric_limits<std::uint64_t>::max());
}
