// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/inversion/likelihood_profile.h"

#include <boost/test/unit_test.hpp>

#include <cmath>
#include <vector>

using gr::wiforce::kernel::likelihood_profile;

namespace {

constexpr std::size_t nodes = 24;
constexpr double first = 1.0, last = 9.0, middle_mm = 40.0;

// All of the plane of phases is one cell of one row.
const std::vector<likelihood_profile::cell> one_cell{ { 0, 1 } };

// Phases psi_i = +-slope (l - l0) + bend_i(F): the far end moves a quarter as much as the
// near one.
double bend(int port, double force, double reach)
{
    return (port ? 0.25 : 1.0) * reach * (1 - 1 / std::cbrt(force));
}

likelihood_profile made(double reach)
{
    std::vector<double> force(nodes);
    std::vector<float> rows(likelihood_profile::columns * nodes);
    for (std::size_t k = 0; k < nodes; k++) {
        force[k] = first * std::pow(last / first, double(k) / (nodes - 1));
        const double at_4[] = { bend(0, 4.0, reach), bend(1, 4.0, reach) };
        const double e[] = { at_4[0] - bend(0, force[k], reach),
                             at_4[1] - bend(1, force[k], reach) };
        const double s[] = { -2.0, 2.0 };
        // the location that fits best where the phases are those of 4 N in the middle
        const double move = (s[0] * e[0] + s[1] * e[1]) / 8.0;
        const auto put = [&](int column, double value) {
            rows[column * nodes + k] = static_cast<float>(value);
        };
        put(likelihood_profile::place, middle_mm + move);
        put(likelihood_profile::error_1, e[0] - s[0] * move);
        put(likelihood_profile::error_2, e[1] - s[1] * move);
        put(likelihood_profile::slope_1, s[0]);
        put(likelihood_profile::slope_2, s[1]);
        put(likelihood_profile::variance_1, 0.01);
        put(likelihood_profile::variance_2, 0.02);
        put(likelihood_profile::inside, 1);
    }
    return { force, rows, std::vector<std::uint8_t>(nodes - 1, 1), one_cell };
}

// The likelihood added up on a fine grid of force and location.
std::vector<double> brute_force(double reach, double e1, double e2, double noise)
{
    double sums[6] = {};
    for (double force = first + 0.005; force < last; force += 0.01)
        for (double l = 20.005; l < 60; l += 0.01) {
            const double r1 =
                e1 + bend(0, 4, reach) - bend(0, force, reach) + 2 * (l - 40);
            const double r2 =
                e2 + bend(1, 4, reach) - bend(1, force, reach) - 2 * (l - 40);
            const double w =
                std::exp(-0.5 * (r1 * r1 / (noise + 0.01) + r2 * r2 / (noise + 0.02)));
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

BOOST_AUTO_TEST_CASE(moments_are_those_of_the_likelihood_added_up_on_a_fine_grid)
{
    // from well observed to hardly at all
    for (const double reach : { 60.0, 8.0, 1.0 })
        for (const double noise : { 0.05, 1.0 })
            for (const double offset : { -0.8, 0.0, 0.7 }) {
                const auto found =
                    made(reach).read(0, offset, -0.3 * offset, noise, noise);
                const auto expected = brute_force(reach, offset, -0.3 * offset, noise);
                const double std = std::sqrt(expected[2]);
                // between nodes z is taken as straight
                BOOST_TEST(std::abs(found.force - expected[0]) < 0.02 * std + 0.003);
                BOOST_TEST(std::abs(found.location - expected[1]) < 0.02);
                BOOST_TEST(found.force_variance == expected[2],
                           boost::test_tools::tolerance(0.05));
                BOOST_TEST(found.location_variance == expected[3],
                           boost::test_tools::tolerance(0.05));
                BOOST_TEST(std::abs(found.covariance - expected[4]) <
                           0.05 * std::sqrt(expected[2] * expected[3]));
                BOOST_TEST(found.ambiguous == 0);
            }
}

BOOST_AUTO_TEST_CASE(phases_that_no_force_shows_have_a_large_misfit)
{
    const auto found = made(8.0).read(0, 30.0, 30.0, 0.01, 0.01);
    BOOST_TEST(found.misfit > 100);
    const auto beyond = made(8.0).read(0, 1.0, 1e6, 0.01, 0.01);
    BOOST_TEST(std::isfinite(beyond.force));
}

BOOST_AUTO_TEST_CASE(a_row_that_holds_nowhere_gives_no_force)
{
    const likelihood_profile none(
        { 1, 2 }, std::vector<float>(18, 1.0F), { 0 }, one_cell);
    const auto found = none.read(0, 0, 0, 1, 1);
    BOOST_TEST(std::isnan(found.force));
    BOOST_TEST(std::isinf(found.misfit));
}

BOOST_AUTO_TEST_CASE(phases_are_read_by_every_row_of_their_cell)
{
    const std::vector<float> rows(2 * 18, 1.0F);
    std::vector<likelihood_profile::cell> cells(36 * 36, { 0, 0 });
    cells[35 * 36 + 2] = { 0, 1 }; // -10 to 0 deg, 20 to 30 deg
    cells[0] = { 0, 2 };
    const likelihood_profile some({ 1, 2 }, rows, { 0, 0 }, cells);
    BOOST_TEST(some.read_turns(-5, 25, 1, 1).count == 1);
    BOOST_TEST(some.read_turns(355, -335, 1, 1).count == 1);
    BOOST_TEST(some.read_turns(5 + 720, 5, 1, 1).count == 2);
    BOOST_TEST(some.read_turns(15, 5, 1, 1).count == 0);
}

BOOST_AUTO_TEST_CASE(tables_of_the_wrong_size_are_refused)
{
    const auto refused = [](std::vector<double> force,
                            std::size_t numbers,
                            std::vector<std::uint8_t> holds,
                            std::vector<likelihood_profile::cell> cells) {
        BOOST_CHECK_THROW(
            likelihood_profile(
                force, std::vector<float>(numbers), holds, std::move(cells)),
            std::invalid_argument);
    };
    refused({ 1 }, 0, {}, one_cell);
    refused(
        std::vector<double>(33, 1.0), 33 * 9, std::vector<std::uint8_t>(32), one_cell);
    refused({ 1, 2 }, 17, { 1 }, one_cell);
    refused({ 1, 2 }, 18, {}, one_cell);
    refused({ 1, 2 }, 18, { 1 }, {});
    refused({ 1, 2 }, 18, { 1 }, { { 0, 1 }, { 0, 1 } });
    refused({ 1, 2 }, 18, { 1 }, { { 1, 1 } });
    refused({ 1, 2 }, 18, { 1 }, { { 0, 2 } });
    refused({ 1, 2 }, 18, { 1 }, { { -1, 1 } });
}
