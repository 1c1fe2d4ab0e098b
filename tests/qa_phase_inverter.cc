// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/inversion/phase_inverter.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <memory>
#include <vector>

using namespace gr::wiforce::kernel;

namespace {

constexpr int cells = 36; // of 10 deg

// A row about (25, 55) deg: 4 N at 40 mm.
inverse_table::row made_row()
{
    return { 4.0,
             40.0,
             { 0.1, 0.02, 0.05, -0.2 },
             { 0.004, 0.001, -0.003 },
             { 0.002, -0.001, 0.005 },
             0.01,
             0.04,
             0.0,
             2.0 };
}

// Force and location by a plain polynomial about (25, 55) deg.
std::pair<double, double> solution(double psi_1, double psi_2)
{
    const double x = psi_1 - 25, y = psi_2 - 55;
    return { 4 + 0.1 * x + 0.02 * y + 0.002 * x * x + 0.001 * x * y - 0.0015 * y * y,
             40 + 0.05 * x - 0.2 * y + 0.001 * x * x - 0.001 * x * y + 0.0025 * y * y };
}

inverse_table table_of(const inverse_table::row& row)
{
    std::vector<std::int32_t> row_of(cells * cells, -1);
    row_of[2 * cells + 5] = 0;
    return { { row }, row_of };
}

// One row, about `middle_mm`: location by the difference of the phases (2 deg/mm at each
// end), force from 1 to 9 N as both fall by `fall_deg`.
void add_row(std::vector<float>& rows, double middle_mm, double fall_deg, double inside)
{
    const auto add = [&](double at_low, double at_high) {
        rows.push_back(static_cast<float>(at_low));
        rows.push_back(static_cast<float>(at_high));
    };
    add(middle_mm, middle_mm);
    add(-fall_deg / 2, fall_deg / 2); // errors, equal at both ends
    add(-fall_deg / 2, fall_deg / 2);
    add(-2, -2);
    add(2, 2);
    add(0.01, 0.01);
    add(0.01, 0.01);
    add(0, 0);
    add(inside, inside);
}

// Cell (0 to 10, 0 to 10) deg has a solution at 30 mm; (50 to 60, 0 to 10) deg two, at 20
// and 60 mm; (100 to 110, 0 to 10) deg the same two, of which only the second is
// calibrated.
std::shared_ptr<const likelihood_profile> made_profile()
{
    std::vector<float> rows;
    add_row(rows, 30, 80, 1);
    add_row(rows, 20, 80, 1);
    add_row(rows, 60, 80, 1);
    add_row(rows, 20, 80, 0);
    add_row(rows, 60, 80, 1);
    std::vector<likelihood_profile::cell> at(cells * cells, { 0, 0 });
    at[0] = { 0, 1 };
    at[5 * cells] = { 1, 2 };
    at[10 * cells] = { 3, 2 };
    at[2 * cells + 5] = { 0, 1 };
    return std::make_shared<likelihood_profile>(
        std::vector<double>{ 1, 9 }, rows, std::vector<std::uint8_t>(5, 1), at);
}

phase_inverter made(const inverse_table::row& row = made_row())
{
    return { table_of(row),
             made_profile(),
             calibrated_span({ 10, 30, 70 }, { 1, 1, 1 }, { 8, 6, 8 }),
             { 0.5, 10, 0, 80, 11.8 } };
}

} // namespace

BOOST_AUTO_TEST_CASE(the_table_is_a_second_order_step_and_its_slopes_give_the_covariance)
{
    const auto table = table_of(made_row());
    const double h = 1e-5, std_1 = 0.3, std_2 = 0.7;
    for (const double psi_1 : { 21.0, 25.0, 28.5, 25.0 - 360 })
        for (const double psi_2 : { 52.0, 59.0, 59.0 + 720 }) {
            const double a = psi_1 < 0 ? psi_1 + 360 : psi_1,
                         b = psi_2 > 360 ? psi_2 - 720 : psi_2;
            const auto found = table.read(psi_1, psi_2, std_1, std_2);
            BOOST_REQUIRE(found.has_value());
            const auto [force, place] = solution(a, b);
            BOOST_TEST(found->force == force, boost::test_tools::tolerance(1e-9));
            BOOST_TEST(found->location == place, boost::test_tools::tolerance(1e-9));
            // slopes by differences
            const auto [f1, l1] = solution(a + h, b);
            const auto [f2, l2] = solution(a, b + h);
            const double n1 = (std_1 * std_1 + 0.01) / (h * h),
                         n2 = (std_2 * std_2 + 0.04) / (h * h);
            const double df1 = f1 - force, df2 = f2 - force, dl1 = l1 - place,
                         dl2 = l2 - place;
            const auto close = boost::test_tools::tolerance(1e-3);
            BOOST_TEST(found->force_variance == df1 * df1 * n1 + df2 * df2 * n2, close);
            BOOST_TEST(found->location_variance == dl1 * dl1 * n1 + dl2 * dl2 * n2,
                       close);
            BOOST_TEST(found->covariance == df1 * dl1 * n1 + df2 * dl2 * n2, close);
            BOOST_TEST(!found->hidden);
        }
}

BOOST_AUTO_TEST_CASE(the_table_holds_only_its_cell_and_only_the_noise_it_was_tried_for)
{
    const auto table = table_of(made_row());
    BOOST_TEST(!table.read(31, 55, 0.1, 0.1).has_value());
    BOOST_TEST(!table.read(25, 49, 0.1, 0.1).has_value());
    BOOST_TEST(table.read(25, 55, 2.0, 0.1).has_value());
    BOOST_TEST(!table.read(25, 55, 0.1, 2.1).has_value());
}

BOOST_AUTO_TEST_CASE(a_force_that_only_a_known_location_would_tell_is_hidden)
{
    // nearly singular: both phases move with force and location alike
    auto row = made_row();
    row.slope[0] = 1.0, row.slope[1] = 1.0;
    row.slope[2] = 0.5, row.slope[3] = 0.52;
    BOOST_TEST(table_of(row).read(25, 55, 0.1, 0.1)->hidden);
    // as steep, but the phases tell the two apart
    row.slope[2] = 0.5, row.slope[3] = -0.5;
    BOOST_TEST(!table_of(row).read(25, 55, 0.1, 0.1)->hidden);
}

BOOST_AUTO_TEST_CASE(a_reading_of_the_table_is_extrapolated_outside_the_span_only)
{
    phase_inverter::reading found;
    // at 40 mm up to 6.5 N are calibrated
    BOOST_TEST(made().read(25, 55, 0.1, 0.1, found) == 0);
    auto row = made_row();
    row.force = 6.7;
    BOOST_TEST(made(row).read(25, 55, 0.1, 0.1, found) == phase_inverter::extrapolated);
    // within its standard deviation of the span
    BOOST_TEST(made(row).read(25, 55, 2.0, 2.0, found) == 0);
    row.in_span = 1;
    BOOST_TEST(made(row).read(25, 55, 0.1, 0.1, found) == 0);
    // outside of where solutions are looked for, the likelihood is asked
    row.force = 11;
    made(row).read(25, 55, 0.1, 0.1, found);
    BOOST_TEST(found.force < 9.0);
}

BOOST_AUTO_TEST_CASE(where_the_table_has_nothing_the_likelihood_is_integrated)
{
    phase_inverter::reading found;
    const auto flags = made().read(5.0 + 8, 5.0 + 8, 0.5, 0.5, found);
    BOOST_TEST(flags == phase_inverter::unknown); // another cell
    // errors of both ends cross zero in the middle of the forces; location of their
    // difference
    BOOST_TEST(made().read(6, 4, 0.5, 0.5, found) == 0);
    BOOST_TEST(found.force == 5.0, boost::test_tools::tolerance(1e-3));
    BOOST_TEST(found.location == 30 - 0.5, boost::test_tools::tolerance(1e-3));
    // 10 deg of phase at each end make a newton, half a degree at each end makes a
    // quarter mm
    const double variance = (0.25 + 0.01) / 2;
    BOOST_TEST(found.covariance[0] == variance / 100, boost::test_tools::tolerance(1e-2));
    BOOST_TEST(found.covariance[3] == variance / 4, boost::test_tools::tolerance(1e-2));
    BOOST_TEST(std::abs(found.covariance[1]) < 1e-4);
    BOOST_TEST(found.covariance[1] == found.covariance[2]);
}

BOOST_AUTO_TEST_CASE(of_two_turns_both_are_told_unless_only_one_is_calibrated)
{
    phase_inverter::reading found;
    BOOST_TEST(made().read(55, 5, 0.5, 0.5, found) == phase_inverter::ambiguous);
    // the other solution is 40 mm away: half of its square is in the variance
    BOOST_TEST(found.covariance[3] > 790);
    BOOST_TEST(made().read(105, 5, 0.5, 0.5, found) == 0);
    BOOST_TEST(found.location == 60, boost::test_tools::tolerance(1e-3));
    BOOST_TEST(found.covariance[3] < 1);
}

BOOST_AUTO_TEST_CASE(phases_of_no_press_are_inconsistent_with_a_larger_deviation)
{
    // beyond the highest force by 4.2 standard deviations of the phases' mean
    auto far = table_of(made_row());
    std::vector<float> rows;
    add_row(rows, 30, 1, 1); // 1 deg from the lowest force to the highest
    const auto profile = std::make_shared<likelihood_profile>(
        std::vector<double>{ 1, 9 },
        rows,
        std::vector<std::uint8_t>{ 1 },
        std::vector<likelihood_profile::cell>{ { 0, 1 } });
    const phase_inverter inverter(far,
                                  profile,
                                  calibrated_span({ 10, 70 }, { 0.5, 0.5 }, { 9, 9 }),
                                  { 0.5, 10, 0, 80, 11.8 });
    const double std = 0.3, of_mean = std::sqrt((std * std + 0.01) / 2);
    phase_inverter::reading near, beyond;
    const double rim = 180 - 0.5; // where the phases are those of 9 N
    BOOST_TEST(inverter.read(rim - 3.3 * of_mean, rim - 3.3 * of_mean, std, std, near) ==
               0);
    const double psi = rim - 4.2 * of_mean;
    BOOST_TEST(inverter.read(psi, psi, std, std, beyond) == phase_inverter::inconsistent);
    BOOST_TEST(beyond.force > 7.5);
    BOOST_TEST(beyond.covariance[3] == near.covariance[3] * 4.2 * 4.2 / 11.8,
               boost::test_tools::tolerance(0.02));
    // so far out that the likelihood has no digits left: to be searched
    BOOST_TEST(inverter.read(rim - 10, rim - 10, std, std, beyond) ==
               phase_inverter::unknown);
}

BOOST_AUTO_TEST_CASE(phases_that_are_no_numbers_give_no_force)
{
    phase_inverter::reading found;
    for (const double bad : { double(NAN), double(INFINITY), 1e300 }) {
        BOOST_TEST(made().read(bad, 5, 1, 1, found) == phase_inverter::inconsistent);
        BOOST_TEST(std::isnan(found.force));
        BOOST_TEST(made().read(5, bad, 1, 1, found) == phase_inverter::inconsistent);
    }
}

BOOST_AUTO_TEST_CASE(tables_that_do_not_fit_together_are_refused)
{
    const auto row = made_row();
    BOOST_CHECK_THROW(inverse_table({ row }, {}), std::invalid_argument);
    BOOST_CHECK_THROW(inverse_table({ row }, { 0, 0 }), std::invalid_argument);
    BOOST_CHECK_THROW(inverse_table({ row }, { 1 }), std::invalid_argument);
    BOOST_CHECK_THROW(calibrated_span({ 1 }, { 1 }, { 1 }), std::invalid_argument);
    BOOST_CHECK_THROW(calibrated_span({ 1, 2 }, { 1 }, { 1, 2 }), std::invalid_argument);
}

BOOST_AUTO_TEST_CASE(many_readings_on_all_processors_are_those_of_one_after_the_other)
{
    constexpr std::size_t count = 9001; // in parts of different size
    const auto inverter = made();
    std::vector<double> psi, std;
    for (std::size_t i = 0; i < count; i++) {
        psi.insert(psi.end(), { std::fmod(0.37 * i, 130.0), std::fmod(0.61 * i, 65.0) });
        std.insert(std.end(), { 0.5, 0.4 });
    }
    std::vector<phase_inverter::reading> all(count);
    std::vector<std::uint8_t> flags(count);
    inverter.read_all(psi.data(), std.data(), count, all.data(), flags.data());
    std::size_t known = 0;
    for (std::size_t i = 0; i < count; i++) {
        phase_inverter::reading one{};
        const auto flag = inverter.read(psi[2 * i], psi[2 * i + 1], 0.5, 0.4, one);
        BOOST_REQUIRE_EQUAL(flags[i], flag);
        if (flag == phase_inverter::unknown)
            continue;
        known++;
        BOOST_REQUIRE_EQUAL(all[i].force, one.force);
        BOOST_REQUIRE_EQUAL(all[i].location, one.location);
        for (int k = 0; k < 4; k++)
            BOOST_REQUIRE_EQUAL(all[i].covariance[k], one.covariance[k]);
    }
    BOOST_TEST(known > 100U);
}
