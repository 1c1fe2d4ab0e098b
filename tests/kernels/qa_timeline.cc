// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/timing/timeline.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <limits>
#include <stdexcept>

using namespace gr::wiforce::kernel;
using verdict = timeline::verdict;

namespace {

constexpr double RATE = 12.5e6;
constexpr double NaN = std::numeric_limits<double>::quiet_NaN();

// Time of a sample on a device whose count began at 7.25 s, a third of a sample off:
// gr-uhd gives times to a fraction of a sample, not exactly.
timeline::time device_time(double sample)
{
    const double seconds = 7.25 + (sample + 0.3) / RATE;
    return { static_cast<std::uint64_t>(seconds), seconds - std::floor(seconds) };
}

void expect(timeline::judgement found, timeline::verdict verdict, double off)
{
    BOOST_TEST((found.verdict == verdict));
    BOOST_TEST(found.off == off);
}

} // namespace

BOOST_AUTO_TEST_CASE(
    a_time_on_the_count_loses_nothing_and_a_later_one_tells_what_was_lost)
{
    timeline times(RATE);
    expect(times.note(0, device_time(0)), verdict::agrees, 0);
    expect(times.note(364, device_time(364)), verdict::agrees, 0);
    expect(times.note(10'000'000, device_time(10'000'001)), verdict::gap, 1);
    expect(times.note(10'000'000, device_time(10'000'001)), verdict::agrees, 0);
    expect(times.note(20'000'000, device_time(3599 * RATE)),
           verdict::gap,
           3599 * RATE - 20'000'001);
}

BOOST_AUTO_TEST_CASE(a_time_that_slips_once_moves_no_reading)
{
    timeline times(RATE);
    times.note(0, device_time(0));
    expect(times.note(5000, device_time(4000)), verdict::ignored, -1000);
    expect(
        times.note(6000, device_time(6000 + 3601 * RATE)), verdict::ignored, 3601 * RATE);
    BOOST_TEST(std::isnan(times.note(7000, { 7, NaN }).off));
    BOOST_TEST((times.note(8000, { 7, -0.5 }).verdict == verdict::ignored));
    BOOST_TEST((times.note(8000, { 7, 1e305 }).verdict == verdict::ignored));
    expect(times.note(9000, device_time(9010)), verdict::gap, 10);
}

BOOST_AUTO_TEST_CASE(a_clock_set_anew_is_believed_when_the_next_time_agrees)
{
    timeline times(RATE);
    times.note(0, { 1000, 0.5 });
    BOOST_TEST((times.note(12'500, { 1, 0.5 }).verdict == verdict::ignored));
    expect(times.note(25'000, { 1, 0.501 }), verdict::restarts, 0);
    expect(times.note(37'500, { 1, 0.502 + 40 / RATE }), verdict::gap, 40);
}

BOOST_AUTO_TEST_CASE(a_clock_set_anew_is_believed_by_times_that_come_with_losses_only)
{
    constexpr double BACK = 5 * RATE; // the clock was set so far back
    timeline times(RATE);
    times.note(0, device_time(0));
    double lost = 5000;
    times.expect_loss(5000 % 720, 720); // the frames tell of the first loss
    expect(times.note(10'000, device_time(10'000 + lost - BACK)),
           verdict::ignored,
           lost - 5000 % 720 - BACK);
    lost += 5000;
    expect(
        times.note(20'000, device_time(20'000 + lost - BACK)), verdict::restarts, 5000);
    for (int item = 30'000; item <= 60'000; item += 10'000) {
        lost += 5000;
        expect(times.note(item, device_time(item + lost - BACK)), verdict::gap, 5000);
    }
}

BOOST_AUTO_TEST_CASE(a_slip_told_twice_or_followed_by_the_truth_is_no_clock_set_anew)
{
    timeline times(RATE);
    times.note(0, device_time(0));
    times.note(5000, device_time(4000));
    expect(times.note(6000, device_time(4000)), verdict::ignored, -2000);
    // Later than the doubtful time by what could be a loss, and yet true.
    expect(times.note(7000, device_time(7000)), verdict::agrees, 0);
    times.note(8000, device_time(7000));
    expect(times.note(9000, device_time(9040)), verdict::gap, 40);
    // Of two slips in a row neither goes on from the other.
    times.note(11'000, device_time(11'000 - 7 * RATE));
    expect(times.note(12'000, device_time(12'000 - 5 * RATE)),
           verdict::ignored,
           -40 - 5 * RATE);
}

BOOST_AUTO_TEST_CASE(a_loss_that_was_found_already_is_not_counted_twice)
{
    timeline times(RATE);
    times.note(0, device_time(0));
    times.expect_loss(500, 720);
    expect(times.note(5000, device_time(6940)), verdict::gap, 1440);
    expect(times.note(6000, device_time(7940)), verdict::agrees, 0);
}

BOOST_AUTO_TEST_CASE(a_true_time_is_believed_after_samples_that_came_twice)
{
    timeline times(RATE);
    times.note(0, device_time(0));
    times.expect_loss(720 - 100, 720);
    expect(times.note(5000, device_time(4900)), verdict::agrees, 0);
    expect(times.note(6000, device_time(5950)), verdict::gap, 50);
    times.expect_loss(720 - 100, 720);
    expect(times.note(7000, device_time(6843)), verdict::ignored, -727);
}

BOOST_AUTO_TEST_CASE(every_item_has_a_time_after_the_first_that_was_told)
{
    timeline times(RATE);
    BOOST_TEST(!times.time_at(5).has_value());
    times.note(100, { 3, 0.75 });
    const auto time = times.time_at(100 + 2 * 12'500'000 + 5'000'000).value();
    BOOST_TEST(time.seconds == 6);
    // Doubles near 3 s have steps of 4e-16 s.
    BOOST_TEST(std::abs(time.fraction - 0.15) < 1e-14);
}
