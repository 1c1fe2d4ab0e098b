// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/doppler_transform.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <random>
#include <set>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using complex = std::complex<double>;

namespace {

constexpr int LENGTH = 75; // two whole blocks and a part of one

constexpr int ROWS = 4;

std::vector<complex> random_rows()
{
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    std::vector<complex> rows(ROWS * LENGTH);
    for (auto& w : rows)
        w = complex(normal(random), normal(random));
    return rows;
}

std::vector<fc32> snapshots()
{
    std::mt19937 random(9);
    std::normal_distribution<float> normal;
    std::vector<fc32> h(LENGTH * FFT_LENGTH);
    for (auto& v : h)
        v = fc32(normal(random) + 1, normal(random) - 1);
    return h;
}

std::vector<complex> reference(const std::vector<complex>& rows,
                               const std::vector<fc32>& h,
                               const std::set<int>& absent)
{
    std::vector<complex> tones(ROWS * FFT_LENGTH);
    for (int m = 0; m < ROWS; m++)
        for (int n = 0; n < LENGTH; n++)
            for (int k = 0; k < FFT_LENGTH && !absent.count(n); k++)
                tones[m * FFT_LENGTH + k] +=
                    rows[m * LENGTH + n] * complex(h[n * FFT_LENGTH + k]);
    return tones;
}

void add(phase_group& group, int first_slot, const fc32* snapshots, int count)
{
    std::copy_n(snapshots, count * FFT_LENGTH, group.reserve(first_slot));
    group.accept(count);
}

double largest_error(const std::vector<fc32>& got, const std::vector<complex>& want)
{
    double error = 0;
    for (std::size_t n = 0; n < want.size(); n++)
        error = std::max(error, std::abs(complex(got[n]) - want[n]));
    return error;
}

} // namespace

BOOST_DATA_TEST_CASE(rejected_snapshots_are_left_out_of_the_tones,
                     data::make({ 0, 40 }),
                     first)
{
    // Also where the first snapshot, the reference of the sums, is rejected.
    auto h = snapshots();
    const auto rows = random_rows();
    const auto want = reference(rows, h, { first, 60 });
    h[first * FFT_LENGTH + 3] = h[60 * FFT_LENGTH + 7] = fc32(1e4f, 1e4f);
    phase_group group(LENGTH);
    tone_accumulator accumulator(rows, LENGTH);
    add(group, 0, h.data(), LENGTH);
    group.finish();
    std::vector<std::uint8_t> marks(LENGTH);
    marks[first] = marks[60] = 1;
    group.reject(marks);
    std::vector<fc32> result(ROWS * FFT_LENGTH);
    accumulator.transform(group, result.data());
    BOOST_TEST(largest_error(result, want) < 2e-5);
    BOOST_TEST(group.rejected() == 2);
    BOOST_TEST(group.missing() == 0);
    BOOST_TEST(!group.is_complete());
    BOOST_TEST(group.present() == LENGTH - 2);
}
