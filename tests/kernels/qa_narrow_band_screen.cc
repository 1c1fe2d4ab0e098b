// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/doppler/interference_screen.h"

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

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using marks_t = std::vector<std::uint8_t>;

namespace {

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
