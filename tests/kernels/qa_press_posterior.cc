// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/inversion/press_posterior.h"

#include <boost/test/unit_test.hpp>

#include <array>
#include <cmath>
#include <vector>

using namespace gr::wiforce::kernel;

namespace {

constexpr double first_n = 1.0, last_n = 9.0, middle_mm = 40.0;
constexpr double variance_1 = 0.01, variance_2 = 0.02;

// A line of `slope` deg/mm: the short widens with force by `reach_deg` at port 1 and by a
// quarter of that at port 2.
struct line {
    double reach_deg, slope = 2.0;

    double widening(double force) const { return reach_deg * (1 - 1 / std::cbrt(force)); }
    double phase(int port, double force, double location) const
    {
        return port ? slope * (location - middle_mm) + 0.25 * widening(force)
                    : -slope * (location - middle_mm) + widening(force);
    }

    tabulated_model table(double left_mm = 10, double right_mm = 70) const
    {
        constexpr std::size_t forces = 160;
        const auto locations = static_cast<std::size_t>(2 * (right_mm - left_mm)) + 1;
        std::vector<double> force(forces), location(locations), values;
        for (std::size_t k = 0; k < forces; k++)
            force[k] = first_n * std::pow(last_n / first_n, double(k) / (forces - 1));
        for (std::size_t j = 0; j < locations; j++)
            location[j] = left_mm + 0.5 * double(j);
        for (const double f : force)
            for (const double l : location)
                for (int port = 0; port < 2; port++) {
                    // by the logarithm of force
                    const double rise =
                        (port ? 0.25 : 1.0) * reach_deg / 3 / std::cbrt(f);
                    values.insert(values.end(),
                                  { phase(port, f, l),
                                    rise,
                                    port ? slope : -slope,
                                    0.0,
                                    port ? variance_2 : variance_1 });
                }
        return { force, location, values };
    }
};

calibrated_span everywhere() { return { { 0, 100 }, { 0, 0 }, { 20, 20 } }; }

struct found {
    press_fit::press press;
    std::uint8_t flags;
};

using pair = std::array<double, 2>;

found invert(const press_posterior& posterior,
             double psi_1,
             double psi_2,
             double std,
             const pair& shared = {})
{
    const double phases[] = { psi_1, psi_2 }, stds[] = { std, std };
    press_posterior::workspace work;
    found result;
    result.flags =
        posterior.invert({ phases, stds, nullptr, shared.data() }, work, result.press);
    return result;
}

constexpr double consistent = 11.83;

// The posterior added up on a fine grid of force and location, for forces that are
// log-uniform beforehand.
std::vector<double> brute_force(
    const line& sensor, double psi_1, double psi_2, double std, const pair& shared = {})
{
    const double a = std * std + variance_1 + shared[0] * shared[0],
                 b = std * std + variance_2 + shared[1] * shared[1],
                 ab = shared[0] * shared[1];
    double sums[6] = {};
    for (double force = first_n + 0.005; force < last_n; force += 0.01)
        for (double l = 25.005; l < 55; l += 0.01) {
            const double r1 = psi_1 - sensor.phase(0, force, l),
                         r2 = psi_2 - sensor.phase(1, force, l);
            const double w =
                std::exp(-0.5 * (b * r1 * r1 + a * r2 * r2 - 2 * ab * r1 * r2) /
                         (a * b - ab * ab)) /
                force;
            const double values[] = { 1, force, l, force * force, l * l, force * l };
            for (int i = 0; i < 6; i++)
                sums[i] += w * values[i];
        }
    for (int i = 5; i >= 0; i--)
        sums[i] /= sums[0];
    const double f = sums[1], l = sums[2];
    return { f, l, sums[3] - f * f, sums[4] - l * l, sums[5] - f * l };
}

} // namespace

BOOST_AUTO_TEST_CASE(posterior_wide_or_narrow_has_the_moments_of_a_fine_grid)
{
    // from well observed to hardly at all
    for (const double reach : { 60.0, 8.0, 1.0 })
        for (const double std : { 0.22, 1.0 })
            for (const double offset : { -0.8, 0.0, 0.7 }) {
                const line sensor{ reach };
                const double psi_1 = sensor.phase(0, 4, 40) + offset,
                             psi_2 = sensor.phase(1, 4, 40) - 0.3 * offset;
                const press_posterior posterior(sensor.table(), everywhere(), consistent);
                const auto press = invert(posterior, psi_1, psi_2, std).press;
                const auto expected = brute_force(sensor, psi_1, psi_2, std);
                const double force_std = std::sqrt(expected[2]),
                             location_std = std::sqrt(expected[3]);
                // the mode where that is near the mean
                BOOST_TEST(std::abs(press.force - expected[0]) < 0.3 * force_std);
                BOOST_TEST(std::abs(press.location - expected[1]) < 0.3 * location_std);
                const bool is_mean =
                    std::abs(press.force - expected[0]) < 0.01 * force_std;
                if (!is_mean)
                    continue;
                BOOST_TEST(press.force_variance == expected[2],
                           boost::test_tools::tolerance(0.02));
                BOOST_TEST(press.location_variance == expected[3],
                           boost::test_tools::tolerance(0.02));
                BOOST_TEST(std::abs(press.covariance - expected[4]) <
                           0.02 * force_std * location_std);
            }
}

BOOST_AUTO_TEST_CASE(error_that_both_phases_share_has_the_moments_of_a_fine_grid)
{
    const line sensor{ 60 };
    const press_posterior posterior(sensor.table(), everywhere(), consistent);
    const double psi_1 = sensor.phase(0, 4, 40), psi_2 = sensor.phase(1, 4, 40);
    for (const pair& shared : { pair{ 1, 1 }, { 1.5, 0.5 }, { 2, -2 } }) {
        const auto press = invert(posterior, psi_1, psi_2, 0.3, shared).press;
        const auto expected = brute_force(sensor, psi_1, psi_2, 0.3, shared);
        const double force_std = std::sqrt(expected[2]);
        // The mode, whose covariance is that of phases linear in force.
        BOOST_TEST(std::abs(press.force - expected[0]) < 0.3 * force_std);
        BOOST_TEST(press.force_variance == expected[2],
                   boost::test_tools::tolerance(0.4));
        BOOST_TEST(press.location_variance == expected[3],
                   boost::test_tools::tolerance(0.1));
    }
    // Of one sign it is force, of opposite ones it is location.
    const auto alone = invert(posterior, psi_1, psi_2, 0.3).press,
               common = invert(posterior, psi_1, psi_2, 0.3, { 2, 2 }).press,
               apart = invert(posterior, psi_1, psi_2, 0.3, { 2, -2 }).press;
    BOOST_TEST(common.force_variance > 10 * alone.force_variance);
    BOOST_TEST(common.force_variance > 2 * apart.force_variance);
    BOOST_TEST(apart.location_variance > 2 * common.location_variance);
}

BOOST_AUTO_TEST_CASE(force_that_no_phase_shows_is_unobservable)
{
    const line sensor{ 1 };
    const press_posterior posterior(sensor.table(), everywhere(), consistent);
    BOOST_TEST(invert(posterior, 0.4, 0.1, 0.3).flags ==
               0); // known location gains little
    BOOST_TEST(posterior.profile().fit().unobservable(4, 40, 1) == false);
    // both ends alike: force looks like location
    tabulated_model alike = [] {
        std::vector<double> values;
        for (const double log_force : { 0.0, 1.0 })
            for (const double l : { 30.0, 50.0 })
                for (const double sign : { -1.0, 1.0 })
                    values.insert(values.end(),
                                  { sign * (2 * l + 10 * log_force) + log_force,
                                    sign * 10 + 1,
                                    sign * 2,
                                    0,
                                    0.01 });
        return tabulated_model({ 1, std::exp(1.0) }, { 30, 50 }, values);
    }();
    const press_posterior hidden(alike, everywhere(), consistent);
    BOOST_TEST(hidden.profile().fit().unobservable(2, 40, 1));
    BOOST_TEST(invert(hidden, -80 - 5 + .5, 80 + 5 + .5, 0.5).flags ==
               force_unobservable);
}

BOOST_AUTO_TEST_CASE(
    presses_half_a_wavelength_apart_are_ambiguous_unless_one_is_calibrated)
{
    const line sensor{ 60, 10 }; // the same phases every 36 mm
    const double psi_1 = sensor.phase(0, 4, 30), psi_2 = sensor.phase(1, 4, 30);
    const press_posterior wide(sensor.table(), everywhere(), consistent);
    const auto both = invert(wide, psi_1, psi_2, 0.3);
    BOOST_TEST(both.flags == ambiguous);
    // the standard deviation reaches the other
    BOOST_TEST(both.press.location_variance > 18 * 18);
    const press_posterior half(
        sensor.table(), calibrated_span({ 20, 60 }, { 1, 1 }, { 8, 8 }), consistent);
    const auto one = invert(half, psi_1, psi_2, 0.3);
    BOOST_TEST(one.flags == 0);
    BOOST_TEST(one.press.location == 30.0, boost::test_tools::tolerance(1e-4));
    BOOST_TEST(one.press.location_variance < 0.01);
    // phases of an uncalibrated press that no calibrated one explains
    const press_posterior forces(
        sensor.table(), calibrated_span({ 20, 60 }, { 1, 1 }, { 3, 3 }), consistent);
    const auto harder =
        invert(forces, sensor.phase(0, 6, 64), sensor.phase(1, 6, 64), 0.3);
    BOOST_TEST((harder.flags & extrapolated) != 0);
    BOOST_TEST(harder.press.force == 6.0, boost::test_tools::tolerance(0.05));
}

BOOST_AUTO_TEST_CASE(press_outside_the_calibrated_span_is_extrapolated)
{
    const line sensor{ 60 };
    const press_posterior posterior(
        sensor.table(),
        calibrated_span({ 20, 40, 60 }, { 1, 1, 1 }, { 8, 6, 8 }),
        consistent);
    const auto flags = [&](double force, double location, double std) {
        return invert(posterior,
                      sensor.phase(0, force, location),
                      sensor.phase(1, force, location),
                      std)
            .flags;
    };
    BOOST_TEST(flags(5.8, 40, 0.1) == 0);
    BOOST_TEST(flags(6.4, 40, 0.1) == extrapolated);
    BOOST_TEST(flags(6.4, 40, 3.0) == 0); // within its standard deviation of the span
    BOOST_TEST(flags(4, 62, 0.1) == extrapolated);
}

BOOST_AUTO_TEST_CASE(phases_of_no_press_are_inconsistent_with_a_larger_deviation)
{
    const line sensor{ 8 };
    const press_posterior posterior(sensor.table(), everywhere(), consistent);
    const double rim_1 = sensor.phase(0, last_n, 40), rim_2 = sensor.phase(1, last_n, 40);
    const double std = 0.3, of_sum = std::sqrt(2 * std * std + variance_1 + variance_2);
    const auto beyond = [&](double sum) {
        return invert(posterior, rim_1 + sum / 2, rim_2 + sum / 2, std);
    };
    BOOST_TEST(beyond(3.3 * of_sum).flags == 0);
    const auto far = beyond(4.2 * of_sum), farther = beyond(100);
    BOOST_TEST(far.flags == inconsistent);
    BOOST_TEST(farther.flags == inconsistent);
    BOOST_TEST(far.press.force_variance > beyond(3.3 * of_sum).press.force_variance);
    // nothing is known of the force then
    BOOST_TEST(farther.press.force_variance == 64.0 / 12,
               boost::test_tools::tolerance(0.1));
    BOOST_TEST(farther.press.location_variance > 100);
}

BOOST_AUTO_TEST_CASE(phases_and_errors_that_are_not_finite_give_no_force)
{
    const press_posterior posterior(line{ 60 }.table(), everywhere(), consistent);
    for (const double bad : { double(NAN), double(INFINITY), 1e300 }) {
        BOOST_TEST(invert(posterior, bad, 5, 1).flags == inconsistent);
        BOOST_TEST(std::isnan(invert(posterior, bad, 5, 1).press.force));
        BOOST_TEST(invert(posterior, 5, bad, 1).flags == inconsistent);
    }
    for (const double bad : { double(NAN), double(INFINITY) }) {
        const auto found = invert(posterior, 0, 0, 0.3, { bad, 1 });
        BOOST_TEST(found.flags == inconsistent);
        BOOST_TEST(std::isnan(found.press.force));
    }
    BOOST_TEST(invert(posterior, 0, 0, NAN).flags == inconsistent);
    // no noise and more than any
    for (const double std : { 0.0, 1e-12, 1e12, 1e200 })
        BOOST_TEST(std::isfinite(invert(posterior, 30, 5, std).press.force));
}

BOOST_AUTO_TEST_CASE(model_whose_location_jumps_with_force_gives_a_reading)
{
    // from one node of force to the next the phases are those of the line's other half
    const std::vector<double> force{ 1, 2, 4, 8 }, location{ 10, 40, 70 };
    std::vector<double> values;
    for (std::size_t k = 0; k < force.size(); k++)
        for (const double l : location)
            for (const double sign : { -1.0, 1.0 })
                values.insert(values.end(),
                              { sign * 2 * (k % 2 ? 80 - l : l), 0, 0, 0, 0.01 });
    const press_posterior posterior(
        tabulated_model(force, location, values), everywhere(), consistent);
    BOOST_TEST(std::isfinite(invert(posterior, -30, 30, 0.1).press.force));
}
