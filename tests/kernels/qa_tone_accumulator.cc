// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/tone_accumulator.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <stdexcept>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using complex = std::complex<double>;

namespace {

constexpr int LENGTH = 75; // two whole blocks and a part of one

std::vector<complex> random_row(unsigned seed)
{
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    std::vector<complex> row(LENGTH);
    for (auto& w : row)
        w = complex(normal(random), normal(random));
    return row;
}

std::vector<complex> conjugate(std::vector<complex> row)
{
    for (auto& w : row)
        w = std::conj(w);
    return row;
}

std::vector<complex> real_part(std::vector<complex> row)
{
    for (auto& w : row)
        w = w.real();
    return row;
}

struct table {
    const char* name;
    std::vector<std::vector<complex>> rows;
    int real_rows; // that the kernel should need

    std::vector<complex> flat() const
    {
        std::vector<complex> values;
        for (const auto& row : rows)
            values.insert(values.end(), row.begin(), row.end());
        return values;
    }
};
std::ostream& operator<<(std::ostream& out, const table& t) { return out << t.name; }

const std::vector<table> tables = {
    { "one row", { random_row(1) }, 2 },
    { "a pair", { random_row(1), conjugate(random_row(1)) }, 2 },
    { "pairs apart",
      { random_row(1),
        random_row(2),
        conjugate(random_row(1)),
        conjugate(random_row(2)) },
      4 },
    { "real rows",
      { real_part(random_row(1)), random_row(2), real_part(random_row(3)) },
      4 },
    { "five rows, one pair",
      { random_row(1),
        random_row(2),
        random_row(3),
        conjugate(random_row(2)),
        random_row(4) },
      8 },
    { "zeros", { std::vector<complex>(LENGTH) }, 1 },
};

const std::vector<std::set<int>> absences = { {},
                                              { 0 },
                                              { 74 },
                                              { 0, 1, 2, 40, 73, 74 },
                                              [] {
                                                  std::set<int> first_block_and_more;
                                                  for (int n = 0; n < 50; n++)
                                                      first_block_and_more.insert(n);
                                                  return first_block_and_more;
                                              }() };

std::vector<fc32> snapshots(double clutter)
{
    std::mt19937 random(9);
    std::normal_distribution<float> normal;
    std::vector<fc32> h(LENGTH * FFT_LENGTH);
    for (auto& v : h)
        v = fc32(normal(random) + clutter, normal(random) - clutter);
    return h;
}

std::vector<complex>
reference(const table& t, const std::vector<fc32>& h, const std::set<int>& absent)
{
    std::vector<complex> tones(t.rows.size() * FFT_LENGTH);
    for (std::size_t m = 0; m < t.rows.size(); m++)
        for (int n = 0; n < LENGTH; n++)
            for (int k = 0; k < FFT_LENGTH && !absent.count(n); k++)
                tones[m * FFT_LENGTH + k] +=
                    t.rows[m][n] * complex(h[n * FFT_LENGTH + k]);
    return tones;
}

void add(phase_group& group, int first_slot, const fc32* snapshots, int count)
{
    std::copy_n(snapshots, count * FFT_LENGTH, group.reserve(first_slot));
    group.accept(count);
}

std::vector<fc32>
tones(const table& t, const std::vector<fc32>& h, const std::set<int>& absent, int packet)
{
    phase_group group(LENGTH);
    tone_accumulator accumulator(t.flat(), LENGTH);
    std::vector<fc32> result(t.rows.size() * FFT_LENGTH);
    for (int round = 0; round < 2; round++) { // the second finds a used object
        group.clear();
        for (int n = 0; n < LENGTH;) {
            int count = 0;
            while (n + count < LENGTH && count < packet && !absent.count(n + count))
                count++;
            if (count)
                add(group, n, &h[n * FFT_LENGTH], count);
            n += std::max(count, 1);
        }
        group.finish();
        accumulator.transform(group, result.data());
    }
    return result;
}

double largest_error(const std::vector<fc32>& got, const std::vector<complex>& want)
{
    double error = 0;
    for (std::size_t n = 0; n < want.size(); n++)
        error = std::max(error, std::abs(complex(got[n]) - want[n]));
    return error;
}

} // namespace

BOOST_DATA_TEST_CASE(tones_are_the_sums_over_the_snapshots_present,
                     data::make(tables) * data::make({ 0, 1, 2, 3, 4 }),
                     rows,
                     absence)
{
    const auto h = snapshots(0);
    const auto want = reference(rows, h, absences[absence]);
    // 75 products of normal values in float
    BOOST_TEST(largest_error(tones(rows, h, absences[absence], LENGTH), want) < 2e-5);
}

BOOST_DATA_TEST_CASE(conjugate_and_real_rows_share_their_sums, data::make(tables), rows)
{
    BOOST_TEST(tone_accumulator(rows.flat(), LENGTH).real_rows() == rows.real_rows);
}

BOOST_DATA_TEST_CASE(packets_do_not_change_a_bit, data::make(tables), rows)
{
    const auto h = snapshots(0);
    const auto whole = tones(rows, h, absences[3], LENGTH);
    for (const int packet : { 1, 7, 33 })
        BOOST_TEST((tones(rows, h, absences[3], packet) == whole));
}

BOOST_AUTO_TEST_CASE(a_static_path_leaves_by_the_zero_of_the_table)
{
    // Row with zero sum: what a clutter of 1e4 leaves must be far below its float
    // rounding (1e4 2^-24 sqrt 75 |w| = 5e-3).
    auto row = random_row(1);
    complex sum = 0;
    for (const auto& w : row)
        sum += w;
    for (auto& w : row)
        w -= sum / double(LENGTH);
    const table t = { "zero sum", { row }, 2 };
    const auto h = snapshots(1e4);
    BOOST_TEST(largest_error(tones(t, h, {}, LENGTH), reference(t, h, {})) < 2e-5);
}

BOOST_AUTO_TEST_CASE(snapshots_that_are_not_finite_count_as_absent)
{
    auto h = snapshots(0);
    const auto want = reference(tables[2], h, { 0, 20, 74 });
    h[5] = fc32(std::numeric_limits<float>::quiet_NaN(), 0);
    h[20 * FFT_LENGTH + 63] = fc32(0, -std::numeric_limits<float>::infinity());
    h[74 * FFT_LENGTH] = fc32(std::numeric_limits<float>::infinity(), 0);
    BOOST_TEST(largest_error(tones(tables[2], h, {}, 10), want) < 2e-5);
}

BOOST_AUTO_TEST_CASE(a_group_gives_zeros_and_a_mask_for_what_is_absent)
{
    const auto h = snapshots(0);
    phase_group group(4);
    add(group, 1, h.data(), 2);
    group.finish();
    BOOST_TEST((group.mask() == std::vector<std::uint8_t>{ 0, 1, 1, 0 }));
    BOOST_TEST(group.missing() == 2);
    const auto copy = group.with_zeros();
    for (int k = 0; k < FFT_LENGTH; k++) {
        BOOST_TEST(copy[k] == fc32(0));
        BOOST_TEST(copy[FFT_LENGTH + k] == h[k]);
        BOOST_TEST(copy[3 * FFT_LENGTH + k] == fc32(0));
    }
    const auto present = group.present_snapshots();
    BOOST_TEST(present.size() == 2 * FFT_LENGTH);
    BOOST_TEST(std::equal(present.begin(), present.end(), h.begin()));
}

BOOST_AUTO_TEST_CASE(a_group_goes_on_in_the_memory_that_it_is_given)
{
    const auto h = snapshots(0);
    phase_group group(4);
    add(group, 1, h.data(), 1);
    std::vector<fc32> own(4 * FFT_LENGTH), other(own.size());
    group.write_to(own.data());
    add(group, 2, h.data() + FFT_LENGTH, 1);
    group.finish();
    const auto want = group.with_zeros();
    group.copy_to(own.data());
    BOOST_TEST((own == want));
    group.write_to();
    std::fill(own.begin(), own.end(), fc32(7));
    group.copy_to(other.data());
    BOOST_TEST((other == want));
}

BOOST_DATA_TEST_CASE(rejected_snapshots_are_left_out_of_the_tones,
                     data::make({ 0, 40 }),
                     first)
{
    // Also where the first snapshot, the reference of the sums, is rejected.
    auto h = snapshots(1);
    const auto want = reference(tables[2], h, { first, 60 });
    h[first * FFT_LENGTH + 3] = h[60 * FFT_LENGTH + 7] = fc32(1e4f, 1e4f);
    phase_group group(LENGTH);
    tone_accumulator accumulator(tables[2].flat(), LENGTH);
    add(group, 0, h.data(), LENGTH);
    group.finish();
    std::vector<std::uint8_t> marks(LENGTH);
    marks[first] = marks[60] = 1;
    group.reject(marks);
    std::vector<fc32> result(tables[2].rows.size() * FFT_LENGTH);
    accumulator.transform(group, result.data());
    BOOST_TEST(largest_error(result, want) < 2e-5);
    BOOST_TEST(group.rejected() == 2);
    BOOST_TEST(group.missing() == 0);
    BOOST_TEST(!group.is_complete());
    BOOST_TEST(group.present_snapshots().size() == (LENGTH - 2) * FFT_LENGTH);
}

BOOST_AUTO_TEST_CASE(bad_tables_are_refused)
{
    BOOST_CHECK_THROW(tone_accumulator({}, 5), std::invalid_argument);
    BOOST_CHECK_THROW(tone_accumulator({ 1, 2, 3 }, 2), std::invalid_argument);
    BOOST_CHECK_THROW(tone_accumulator({ 1, 2 }, 0), std::invalid_argument);
    BOOST_CHECK_THROW(tone_accumulator({ 1, std::nan("") }, 2), std::invalid_argument);
    BOOST_CHECK_THROW(phase_group(0), std::invalid_argument);
}
