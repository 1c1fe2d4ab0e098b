// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/recording/recording.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <future>
#include <numeric>

#include <unistd.h>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

constexpr std::uint64_t SAMPLES = 50'000; // 49 pages
constexpr std::uint64_t FIRST = 300;      // in the middle of a page

// A file of sc16 samples that count up, behind a header.
struct counted_file {
    explicit counted_file(int header = 0)
    {
        std::vector<char> nothing(header);
        std::vector<std::int32_t> counts(SAMPLES);
        std::iota(counts.begin(), counts.end(), 0);
        std::ofstream out(path, std::ios::binary);
        out.write(nothing.data(), nothing.size());
        out.write(reinterpret_cast<const char*>(counts.data()), 4 * SAMPLES);
    }

    ~counted_file() { std::filesystem::remove(path); }

    const std::string path = std::filesystem::temp_directory_path() /
                             ("qa_recording." + std::to_string(getpid()));
    const std::vector<recording::segment> segments = { { 0, 0, SAMPLES } };
};

// Whether a piece holds so many samples of the file, from FIRST on.
bool is_counted(const recording::piece& at, std::uint64_t count)
{
    std::vector<std::int32_t> expected(count);
    std::iota(expected.begin(), expected.end(), std::int32_t(FIRST));
    return std::equal(at.samples,
                      at.samples + 4 * count,
                      reinterpret_cast<const char*>(expected.data()));
}

} // namespace

BOOST_DATA_TEST_CASE(a_piece_holds_the_samples_with_and_without_a_mapping,
                     data::make({ "mapped", "written to", "odd header" }),
                     how)
{
    const bool is_odd = std::string(how) == "odd header";
    const counted_file file(is_odd ? 3 : 0);
    std::ofstream writer;
    if (std::string(how) == "written to")
        writer.open(file.path, std::ios::binary | std::ios::in);
    const recording samples(file.path, "ci16_le", file.segments, is_odd ? 3 : 0);
    recording::piece at;
    BOOST_TEST(samples.look(FIRST, 20'000, at) == 20'000u);
    BOOST_TEST(is_counted(at, 20'000));
    BOOST_TEST(samples.let_go(at) == (std::string(how) == "mapped"));
    BOOST_TEST(samples.look(FIRST, SAMPLES, at) == SAMPLES - FIRST);
    BOOST_TEST(is_counted(at, SAMPLES - FIRST));
    samples.let_go(at);
    BOOST_TEST(samples.samples_missing() == 0u);
}

// A process that reads a page of a mapping that is cut off ends by a signal.
BOOST_DATA_TEST_CASE(a_file_is_not_cut_short_while_it_is_looked_at,
                     data::make({ 0u, 4000u }),
                     kept)
{
    const counted_file file;
    const recording samples(file.path, "ci16_le", file.segments, 0);
    recording::piece one, other;
    BOOST_TEST(samples.look(FIRST, SAMPLES - FIRST, one) == SAMPLES - FIRST);
    BOOST_TEST(samples.look(0, 100, other) == 100u);
    auto cut = std::async(std::launch::async, [kept, path = file.path] {
        std::filesystem::resize_file(path, 4 * kept);
    });
    // Nobody else looks into the mapping once somebody waits to write to the file.
    while (samples.let_go(other))
        samples.look(0, 100, other);
    BOOST_TEST(
        (cut.wait_for(std::chrono::milliseconds(20)) == std::future_status::timeout));
    BOOST_TEST(is_counted(one, SAMPLES - FIRST));
    BOOST_TEST(samples.let_go(one));
    cut.get();
    const std::uint64_t left = kept - std::min<std::uint64_t>(kept, FIRST);
    BOOST_TEST(samples.look(FIRST, SAMPLES - FIRST, one) == left);
    BOOST_TEST(is_counted(one, left));
    samples.let_go(one);
    BOOST_TEST(samples.samples_missing() == SAMPLES - FIRST - left);
}
