// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/fold/frame_walk.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

using indices = std::vector<std::uint64_t>;

// Unbroken samples of a stream, by the positions of the first and behind the last.
struct run {
    std::uint64_t begin;
    std::uint64_t end;
};

struct layout {
    int frame_length;
    int first_averaged;
    int repetitions;
    std::uint64_t offset;
};

std::ostream& operator<<(std::ostream& stream, const layout& l)
{
    return stream << l.frame_length << ' ' << l.first_averaged << ' ' << l.repetitions
                  << ' ' << l.offset;
}

const std::vector<layout> layouts = {
    { 720, 64, 4, 0 }, { 720, 192, 2, 719 }, { 320, 64, 4, 5 }, { 64, 0, 1, 3000 }
};

// Frames of which a run holds every averaged sample, by looking at each.
indices whole_frames(const std::vector<run>& runs, const layout& l)
{
    indices frames;
    for (const run& r : runs)
        for (std::uint64_t frame = 0; frame * l.frame_length < r.end; frame++) {
            const std::uint64_t first =
                l.offset + l.first_averaged + frame * l.frame_length;
            if (r.begin <= first && first + 64 * l.repetitions <= r.end)
                frames.push_back(frame);
        }
    return frames;
}

std::vector<run> random_runs(unsigned seed)
{
    std::mt19937 random(seed);
    std::uniform_int_distribution<int> length(1, 5000), gap(0, 1500);
    std::vector<run> runs;
    std::uint64_t position = 0;
    while (runs.size() < 12) {
        const std::uint64_t end = position + length(random);
        runs.push_back({ position, end });
        position = end + gap(random);
    }
    return runs;
}

// Walks over the runs in pieces of at most `piece` samples; returns the frames found.
indices walked_frames(frame_walk& walk, const std::vector<run>& runs, std::uint64_t piece)
{
    const std::vector<fc32> silence(65536);
    indices frames;
    for (const run& r : runs) {
        walk.skip(r.begin - walk.position());
        std::uint64_t arrived = r.begin;
        while (arrived < r.end) {
            arrived = std::min(arrived + piece, r.end);
            const auto left = [&] {
                return std::min(arrived - walk.position(), walk.until_decision());
            };
            while (true) {
                walk.pass(silence.data(), std::min(left(), walk.lead()));
                const std::uint64_t whole = walk.whole_frames(left());
                for (std::uint64_t n = 0; n < whole; n++)
                    frames.push_back(walk.frame() + n);
                if (whole > 0)
                    walk.pass(silence.data(), walk.span(whole));
                else if (walk.decision_is_due())
                    BOOST_REQUIRE(walk.decide() == 0);
                else
                    break;
            }
        }
        walk.skip(r.end - walk.position());
    }
    return frames;
}

} // namespace

BOOST_DATA_TEST_CASE(frame_walk_over_gaps_finds_the_whole_frames_of_a_plain_search,
                     data::make(layouts) * data::make({ 1u, 63u, 720u, 1u << 20 }) *
                         data::xrange(1u, 5u),
                     layout,
                     piece,
                     seed)
{
    const preamble_folder folder(
        layout.frame_length, layout.first_averaged, layout.repetitions);
    frame_walk walk(folder, layout.offset);
    const auto runs = random_runs(seed);
    BOOST_TEST(walked_frames(walk, runs, piece) == whole_frames(runs, layout),
               boost::test_tools::per_element());
}

BOOST_AUTO_TEST_CASE(frame_walk_inside_averaged_samples_goes_on_with_the_next_frame)
{
    frame_walk walk(preamble_folder(720, 64, 4), 10);
    walk.skip(74);
    BOOST_TEST(walk.frame() == 0);
    BOOST_TEST(walk.lead() == 0);
    walk.skip(1);
    BOOST_TEST(walk.frame() == 1);
    BOOST_TEST(walk.lead() == 719);
    BOOST_TEST(walk.whole_frames(719 + 255) == 0);
    BOOST_TEST(walk.whole_frames(719 + 256) == 1);
    BOOST_TEST(walk.whole_frames(719 + 256 + 720) == 2);
    BOOST_TEST(walk.span(2) == 719 + 256 + 720);
}

BOOST_DATA_TEST_CASE(frame_walk_after_an_unreported_loss_returns_to_the_grid,
                     data::make({ 1, 30, 63, 89 }))
{
    constexpr int length = 90, lost_in_frame = 20;
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    std::vector<fc32> frame(length);
    for (int n = 0; n < 64; n++)
        frame[n] = { normal(random), normal(random) };
    frame_walk walk(preamble_folder(length, 0, 1), 0);
    std::uint64_t taken = 0, slipped = 0; // samples
    const auto next = [&] { return frame[taken++ % length]; };
    while (slipped == 0 && taken < 20'000u * length) {
        if (walk.frame() == lost_in_frame && walk.lead() == length - 1)
            taken += sample;
        if (walk.decision_is_due()) {
            slipped = walk.decide();
        } else {
            const fc32 value = next();
            walk.pass(&value, 1);
        }
    }
    BOOST_TEST(slipped == sample);
    BOOST_TEST(walk.position() % length == taken % length);
}

BOOST_AUTO_TEST_CASE(full_scale_is_noticed_where_samples_are_averaged)
{
    const int frames = 5;
    const preamble_folder folder(720, 64, 4);
    std::vector<sc16> x(frames * 720, sc16(32751, -32751));
    std::vector<int> found = { 7 };
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    const auto fold = [&](const auto& samples, int count) {
        folder.fold(&samples[64], count, folded.data(), noise.data(), &found);
    };
    fold(x, frames);
    BOOST_TEST(found.empty());
    x[63] = x[320] = sc16(32767, -32768); // beside the averaged part of frame 0
    fold(x, frames);
    BOOST_TEST(found.empty());
    x[720 + 64] = sc16(0, 32752);
    x[3 * 720 + 319] = sc16(-32752, 0);
    fold(x, frames);
    BOOST_TEST(found == std::vector<int>({ 1, 3 }), boost::test_tools::per_element());
    std::vector<fc32> floats(frames * 720, fc32(0.999f, -0.999f));
    fold(floats, frames);
    BOOST_TEST(found.empty());
    floats[64] = fc32(2, 0); // no converter limits these
    floats[720 + 64] = fc32(0, 0.9999f);
    floats[2 * 720 + 319] = fc32(-32768 / 32767.0f, 0);
    floats[4 * 720 + 63] = fc32(1, 1); // beside the averaged part
    fold(floats, frames);
    BOOST_TEST(found == std::vector<int>({ 1, 2 }), boost::test_tools::per_element());
}

// Frames of which a converter of 12 bits, or an amplifier, limits the largest sample.
BOOST_DATA_TEST_CASE(samples_limited_below_full_scale_are_noticed,
                     data::make({ 0.0, 0.3, 2.0, 50.0 }) * data::make({ false, true }),
                     noise_codes,
                     limited)
{
    const int frames = 11;
    std::mt19937 random(5);
    std::normal_distribution<double> normal;
    std::vector<double> symbol(128);
    for (auto& part : symbol)
        part = 500 * normal(random);
    symbol[37] = 2500;
    symbol[90] = -2300;
    std::vector<sc16> codes(frames * 720);
    std::vector<fc32> floats(codes.size());
    const auto received = [&](int part) {
        const double value = std::round(symbol[part] + noise_codes * normal(random));
        return limited ? std::clamp(value, -2048.0, 2047.0) : value;
    };
    for (std::size_t n = 0; n < codes.size(); n++) {
        const int part = 2 * (n % 720 % 64);
        codes[n] = sc16(received(part), received(part + 1));
        floats[n] = fc32(codes[n].real(), codes[n].imag()) * 1e-4f;
    }
    const preamble_folder folder(720, 64, 4);
    std::vector<int> found;
    std::vector<fc32> folded(64 * frames);
    std::vector<snapshot_noise> noise(frames);
    // Without noise of some codes every sample has one value, limited or not.
    const std::size_t expected = limited && noise_codes >= 2 ? frames : 0;
    folder.fold(&codes[64], frames, folded.data(), noise.data(), &found);
    BOOST_TEST(found.size() == expected);
    folder.fold(&floats[64], frames, folded.data(), noise.data(), &found);
    BOOST_TEST(found.size() == expected);
    folder.fold(&codes[64], 1, folded.data(), noise.data(), &found);
    BOOST_TEST(found.empty()); // too few to tell
}
