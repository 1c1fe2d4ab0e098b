// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/screening/narrow_band_screen.h"

#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <random>
#include <vector>

using namespace gr::wiforce::kernel;

constexpr int FFT_LENGTH = DEFAULT_SYMBOL_LENGTH;
using marks_t = std::vector<std::uint8_t>;
using complex_t = std::complex<double>;

namespace {

constexpr int LENGTH = 80;

// The rule of the screen as it is described, written plainly: a transform by its
// definition, medians of sorted values, all changes computed anew for each group.
class plain_screen
{
public:
    void keep(const phase_group& group, marks_t& marks)
    {
        std::vector<std::vector<double>> changes(LENGTH);
        for (int n = 0; n < LENGTH; n++)
            changes[n] = change_of(group, n);
        std::vector<int> unmarked, quiet;
        for (int n = 0; n < LENGTH; n++)
            if (!marks[n] && group.mask()[n])
                unmarked.push_back(n);
        const std::size_t most = std::min<std::size_t>(unmarked.size(), 32);
        std::vector<double> quiet_medians, quiet_means;
        for (std::size_t i = 0; i < most; i++) {
            const int n = unmarked[i * unmarked.size() / most];
            if (changes[n].empty())
                continue;
            quiet.push_back(n);
            quiet_medians.push_back(median(changes[n]));
        }
        if (quiet_medians.size() >= 8)
            d_typical.push_back(lower(quiet_medians, .15));
        if (d_typical.size() > (4096 + LENGTH - 1) / LENGTH)
            d_typical.erase(d_typical.begin());
        const double typical = d_typical.empty() ? 0 : lower(d_typical, .25),
                     limit = 2.5 * typical;
        std::vector<int> narrow(LENGTH + 2), kept; // with one more at each end
        for (int n = 0; n < LENGTH; n++)
            narrow[n + 1] = marks[n] && !changes[n].empty() &&
                            median(changes[n]) < std::max(limit, .2 * mean(changes[n]));
        std::vector<double> spectrum(FFT_LENGTH);
        int summed = 0;
        for (int n = 0; n < LENGTH; n++) {
            if (marks[n] && narrow[n] + narrow[n + 1] + narrow[n + 2] >= 2)
                kept.push_back(n);
            if (!marks[n] || changes[n].empty() || median(changes[n]) > limit)
                continue;
            summed++;
            for (int k = 0; k < FFT_LENGTH; k++)
                spectrum[k] += changes[n][k];
        }
        for (const int n : quiet)
            if (median(changes[n]) <= limit)
                quiet_means.push_back(mean(changes[n]));
        if (summed == 0)
            return;
        const double level = quiet_means.size() < 8 ? 2 * typical : mean(quiet_means);
        const double share = double(kept.size()) / LENGTH;
        std::vector<double> information;
        for (const double power : spectrum)
            information.push_back(
                1 / (1 + share * std::max(power / summed / level - 1, 0.0)));
        if (mean(information) > 1 - share)
            for (const int n : kept)
                marks[n] = 0;
    }

private:
    static double lower(std::vector<double> values, double part)
    {
        std::sort(values.begin(), values.end());
        return values[static_cast<std::size_t>(part * (values.size() - 1))];
    }
    static double median(std::vector<double> values)
    {
        std::sort(values.begin(), values.end());
        return values[values.size() / 2];
    }
    static double mean(const std::vector<double>& values)
    {
        double sum = 0;
        for (const double value : values)
            sum += value;
        return sum / values.size();
    }
    // Against the neighbour that differs less, per subcarrier; empty without neighbours.
    static std::vector<double> change_of(const phase_group& group, int n)
    {
        std::vector<double> least;
        for (const int other : { n - 1, n + 1 }) {
            if (other < 0 || other >= LENGTH || !group.mask()[n] || !group.mask()[other])
                continue;
            std::vector<double> powers;
            for (int k = 0; k < FFT_LENGTH; k++) {
                complex_t sum = 0;
                for (int i = 0; i < FFT_LENGTH; i++)
                    sum += complex_t(group.slot(n)[i] - group.slot(other)[i]) *
                           std::polar(1.0, -2 * M_PI * k * i / FFT_LENGTH);
                powers.push_back(std::norm(sum));
            }
            if (least.empty() || median(powers) < median(least))
                least = powers;
        }
        return least;
    }

    std::vector<double> d_typical;
};

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

BOOST_AUTO_TEST_CASE(narrow_band_screen_random_groups_keep_what_the_plain_rule_keeps)
{
    narrow_band_screen screen(LENGTH);
    plain_screen plain;
    phase_group group(LENGTH);
    marks_t marks(LENGTH);
    air stream(1);
    int kept_groups = 0, lost_groups = 0;
    for (int g = 0; g < 60; g++) {
        stream.fill(group, marks, 1 << g % 7, g % 2 ? 0.3f : 3.0f);
        marks_t expected = marks;
        const int before = count(marks);
        plain.keep(group, expected);
        const int kept = screen.keep(group, marks);
        BOOST_TEST(marks == expected);
        BOOST_TEST(kept == before - count(expected));
        (kept > 0 ? kept_groups : lost_groups)++;
    }
    BOOST_TEST(kept_groups >= 15);
    BOOST_TEST(lost_groups >= 15);
}

BOOST_AUTO_TEST_CASE(narrow_band_screen_one_subcarrier_is_kept_and_whole_band_is_not)
{
    for (const bool narrow : { true, false }) {
        narrow_band_screen screen(LENGTH);
        phase_group group(LENGTH);
        marks_t marks(LENGTH);
        air(2).fill(group, marks, narrow ? 1 : FFT_LENGTH, 10);
        const int hit = count(marks);
        BOOST_TEST(hit > 8);
        BOOST_TEST(screen.keep(group, marks) == (narrow ? hit : 0));
        BOOST_TEST(count(marks) == (narrow ? 0 : hit));
    }
}
