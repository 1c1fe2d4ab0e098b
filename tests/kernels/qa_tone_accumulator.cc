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

std::vector<fc32> snapshots()
{
    std::mt19937 random(9);
    std::normal_distribution<float> normal;
    std::vector<fc32> h(LENGTH * FFT_LENGTH);
    for (auto& v : h)
        v = fc32(normal(random) + 1, normal(random) - 1);
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

double largest_error(const std::vector<fc32>& got, const std::vector<complex>& want)
{
    double error = 0;
    for (std::size_t n = 0; n < want.size(); n++)
        error = std::max(error, std::abs(complex(got[n]) - want[n]));
    return error;
}

} // namespace

BOOST_DATA_TEST_CASE(conjugate_and_real_rows_share_their_sums, data::make(tables), rows)
{
    BOOST_TEST(tone_accumulator(rows.flat(), LENGTH).real_rows() == rows.real_rows);
}

BOOST_DATA_TEST_CASE(rejected_snapshots_are_left_out_of_the_tones,
                     data::make({ 0, 40 }),
                     first)
{
    // Also where the first snapshot, the reference of the sums, is rejected.
    auto h = snapshots();
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
    BOOST_TEST(group.present() == LENGTH - 2);
}
