// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/screening/interference_screen.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

enum class room { quiet, tags, bursts, rising, lost, coarse };

std::ostream& operator<<(std::ostream& out, room r) { return out << int(r); }

// Groups of snapshots folded from four repetitions of noise, edges of tags and bursts.
class simulated_room
{
public:
    simulated_room(room which, int length) : d_which(which), d_length(length)
    {
        for (auto* path : { &d_static, &d_tag })
            for (auto& value : *path)
                value = draw(path == &d_tag ? 0.1f : 3.0f);
    }

    // Whether a burst hits each snapshot.
    std::vector<bool> fill(phase_group& group, int index)
    {
        std::vector<bool> hits(d_length);
        group.clear();
        fc32* slot = group.reserve(0);
        snapshot_noise* noise = group.noise();
        const float level = d_which == room::rising && index > 5 ? 0.01f * index : 0.01f;
        for (int n = 0; n < d_length; n++, slot += 64) {
            const bool hit = d_which != room::quiet && d_which != room::tags &&
                             std::uniform_int_distribution(0, 19)(d_random) == 0;
            hits[n] = hit;
            const int edge = std::uniform_int_distribution(0, 7)(d_random);
            std::vector<fc32> x(4 * 64);
            for (int i = 0; i < 4 * 64; i++) {
                const bool on = d_which != room::quiet && ((n / 3) % 2) ^ (i / 64 > edge);
                x[i] = d_static[i % 64] + (on ? d_tag[i % 64] : 0) +
                       draw(hit ? 10 * level : level);
                if (d_which == room::coarse)
                    x[i] = { std::round(x[i].real() * 20) / 20,
                             std::round(x[i].imag() * 20) / 20 };
            }
            noise[n] = fold(x, slot);
        }
        if (d_which == room::lost) {
            group.noise()[d_length - 1].largest = std::numeric_limits<float>::quiet_NaN();
            hits.back() = false;
        }
        group.accept(d_length);
        group.finish();
        return hits;
    }

private:
    fc32 draw(float level)
    {
        return { level * d_normal(d_random), level * d_normal(d_random) };
    }

    static snapshot_noise fold(const std::vector<fc32>& x, fc32* folded)
    {
        snapshot_noise noise{};
        for (int k = 0; k < 64; k++) {
            folded[k] = (x[k] + x[64 + k] + x[128 + k] + x[192 + k]) / 4.0f;
            std::vector<float> re, im;
            for (int r = 1; r < 4; r++) {
                const fc32 d = x[64 * r + k] - x[64 * r - 64 + k];
                re.push_back(d.real() * d.real() / 128);
                im.push_back(d.imag() * d.imag() / 128);
            }
            for (const auto& squares : { re, im }) {
                noise.smallest += *std::min_element(squares.begin(), squares.end());
                noise.largest += *std::max_element(squares.begin(), squares.end());
            }
        }
        return noise;
    }

    const room d_which;
    const int d_length;
    std::mt19937 d_random{ 3 };
    std::normal_distribution<float> d_normal;
    std::vector<fc32> d_static = std::vector<fc32>(64), d_tag = std::vector<fc32>(64);
};

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using marks_t = std::vector<std::uint8_t>;
constexpr int LENGTH = 80;

// A static channel with noise in which a transmitter hits every fifth snapshot or so.
class air
{
public:
    explicit air(unsigned seed) : d_random(seed) {}

    // The transmitter uses so many subcarriers; it is `amplitude` above the noise in
    // each.
    void fill(phase_group& group, marks_t& marks, int subcarriers, float amplitude)
    {
        group.clear();
        fc32* out = group.reserve(0);
        const int first = int(d_random() % FFT_LENGTH);
        for (int n = 0; n < LENGTH; n++) {
            // Bursts last two or three snapshots, and some snapshots are lost.
            marks[n] = n % 15 < 2 + n % 2;
            std::vector<fc32> tones(subcarriers);
            for (fc32& tone : tones)
                tone = amplitude * normal();
            for (int i = 0; i < FFT_LENGTH; i++) {
                fc32 value = fc32(50, i) + normal();
                for (int k = 0; k < subcarriers && marks[n]; k++)
                    value +=
                        tones[k] *
                        std::polar(1.0f, float(2 * M_PI * i * (first + k) / FFT_LENGTH));
                out[n * FFT_LENGTH + i] = value;
            }
            if (n % 23 == 22)
                out[n * FFT_LENGTH] = std::numeric_limits<float>::quiet_NaN();
        }
        note_values_not_finite(out, LENGTH, FFT_LENGTH, group.noise());
        group.accept(LENGTH);
        group.finish();
        for (int n = 0; n < LENGTH; n++)
            marks[n] &= group.mask()[n];
    }

private:
    fc32 normal() { return { d_normal(d_random), d_normal(d_random) }; }

    std::mt19937 d_random;
    std::normal_distribution<float> d_normal;
};

int count(const marks_t& marks) { return std::count(marks.begin(), marks.end(), 1); }

} // namespace

BOOST_DATA_TEST_CASE(bursts_are_marked_and_edges_of_tags_are_not,
                     data::make({ room::quiet,
                                  room::tags,
                                  room::bursts,
                                  room::rising,
                                  room::lost,
                                  room::coarse }) *
                         data::make({ 40, 125, 625 }),
                     which,
                     length)
{
    simulated_room simulated(which, length);
    interference_screen screen(length);
    phase_group group(length);
    int hit = 0, found = 0, beside = 0, apart = 0;
    for (int index = 0; index < 12; index++) {
        const auto hits = simulated.fill(group, index);
        const auto& marks = screen.examine(group);
        BOOST_TEST(screen.rejected() == std::count(marks.begin(), marks.end(), 1));
        for (int n = 0; n < length; n++) {
            const bool neighbour =
                (n > 0 && hits[n - 1]) || (n + 1 < length && hits[n + 1]);
            hit += hits[n];
            found += hits[n] && marks[n];
            (neighbour ? beside : apart) += !hits[n] && marks[n];
        }
    }
    // One burst of a room may be missed.
    BOOST_TEST(found >= hit - 1);
    // Noise that rises sixfold at once counts as bursts until it is learned.
    BOOST_TEST((which == room::rising || apart == 0));
    // Edges of the tag beside a burst may be a part of it: in three of eight snapshots.
    BOOST_TEST((which == room::rising || beside <= 0.45 * 2 * hit));
}

BOOST_DATA_TEST_CASE(narrow_band_screen_keeps_snapshots_hit_on_few_subcarriers,
                     data::make({ 1, 2, 4, 8, 32, FFT_LENGTH }) *
                         data::make({ 0.3f, 3.0f, 10.0f }),
                     subcarriers,
                     amplitude)
{
    narrow_band_screen screen(LENGTH);
    phase_group group(LENGTH);
    marks_t marks(LENGTH);
    air stream(1);
    for (int g = 0; g < 20; g++) {
        stream.fill(group, marks, subcarriers, amplitude);
        const int hit = count(marks);
        BOOST_TEST(hit > 8);
        BOOST_TEST(screen.keep(group, marks) == (subcarriers <= 8 ? hit : 0));
        BOOST_TEST(count(marks) == (subcarriers <= 8 ? 0 : hit));
    }
}
