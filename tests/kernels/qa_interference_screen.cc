// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/screening/interference_screen.h"

#include <boost/test/data/monomorphic.hpp>
#include <boost/test/data/test_case.hpp>
#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <random>
#include <vector>

namespace data = boost::unit_test::data;
using namespace gr::wiforce::kernel;

namespace {

using marks_t = std::vector<std::uint8_t>;

// Value at a part of the sorted values.
float sorted_at(std::vector<float> values, double part)
{
    std::sort(values.begin(), values.end());
    return values.empty() ? 0 : values[std::size_t(part * (values.size() - 1))];
}

// The rule of the screen as it is described, written plainly: sorted values, all pairs.
class plain_screen
{
public:
    explicit plain_screen(int length) : d_length(length), d_narrow_band(length) {}

    marks_t examine(const phase_group& group)
    {
        marks_t marks(d_length);
        learn(group);
        if (d_largest.empty())
            return marks;
        bool any = mark_whole(group, marks);
        any |= mark_beyond_tags(group, marks);
        if (!any)
            return marks;
        marks_t beside = marks;
        for (int n = 0; n < d_length; n++)
            if (group.mask()[n] && group.noise_of(n).largest > recent(d_largest) &&
                ((n > 0 && marks[n - 1]) || (n + 1 < d_length && marks[n + 1])))
                beside[n] = 1;
        d_narrow_band.keep(group, beside);
        return beside;
    }

private:
    using levels = std::deque<float>;

    void add(levels& to, float value)
    {
        to.push_back(value);
        if (to.size() > std::size_t((4096 + d_length - 1) / d_length))
            to.pop_front();
    }
    static float recent(const levels& of)
    {
        return sorted_at(std::vector<float>(of.begin(), of.end()), .25);
    }
    static float spread(const std::vector<float>& values)
    {
        const float level = sorted_at(values, .20);
        const float range =
            std::sqrt(sorted_at(values, .25)) - std::sqrt(sorted_at(values, .10));
        return level > 0 ? range / std::sqrt(level) : 0;
    }
    static float limit_of(float level, float spread, float limit)
    {
        return level * std::max(limit, (1 + 16 * spread) * (1 + 16 * spread));
    }

    void learn(const phase_group& group)
    {
        std::vector<float> smallest, largest;
        for (int n = 0; n < d_length; n++)
            if (group.mask()[n] && group.noise_of(n).largest > 0) {
                smallest.push_back(group.noise_of(n).smallest);
                largest.push_back(group.noise_of(n).largest);
            }
        if (largest.empty())
            return;
        const float high = sorted_at(largest, .20), low = sorted_at(smallest, .20);
        const float floor = sorted_at(largest, .03);
        add(d_largest, limit_of(high, spread(largest), 2.2f));
        const bool is_coarse =
            low / floor < 0.08f && (!(low > 0) || spread(smallest) > 0.1f);
        add(d_smallest,
            is_coarse ? d_largest.back()
                      : limit_of(low, spread(smallest), low / floor > 0.2f ? 2.2f : 5));
        const float edge = limit_of(std::max(low / 0.11f, floor), spread(smallest), 2.2f);
        const double edges = std::count_if(
            largest.begin(), largest.end(), [&](float value) { return value > edge; });
        add(d_edges, edges / largest.size());
    }

    bool mark_whole(const phase_group& group, marks_t& marks) const
    {
        float limit = recent(d_smallest);
        const auto hits = [&] {
            marks_t found(d_length);
            for (int n = 0; n < d_length; n++) {
                const auto& noise = group.noise_of(n);
                found[n] = group.mask()[n] && noise.smallest > limit &&
                           noise.smallest > 0.065f * noise.largest &&
                           noise.smallest < noise.largest;
            }
            return found;
        };
        const auto count = [](const marks_t& found) {
            return std::count(found.begin(), found.end(), 1);
        };
        const double share = recent(d_edges), in_one = 1 - std::cbrt(1 - share);
        const double many = std::clamp((share - .70) / (.85 - .70), 0., 1.);
        const double expected = (.5 + many) * std::pow(in_one, 3) * group.present();
        if (count(hits()) > 0 && count(hits()) <= expected + 3 * std::sqrt(expected))
            limit = std::max(limit, tag_level(group, marks));
        marks = hits();
        return count(marks) > 0;
    }

    bool mark_beyond_tags(const phase_group& group, marks_t& marks) const
    {
        const float limit = std::max(recent(d_largest), 3 * tag_level(group, marks));
        const marks_t before = marks;
        for (int n = 0; n < d_length; n++)
            if (group.mask()[n] && group.noise_of(n).largest > limit)
                marks[n] = 1;
        return marks != before;
    }

    static float tag_level(const phase_group& group, const marks_t& marks)
    {
        std::vector<int> slots;
        for (int n = 0; n < group.length(); n++)
            if (group.mask()[n] && !marks[n])
                slots.push_back(n);
        std::vector<float> values;
        for (std::size_t i = 0; !slots.empty() && i < 128; i++) {
            const std::size_t first = i * slots.size() / 128;
            const fc32* a = group.slot(slots[first]);
            const fc32* b = group.slot(slots[(first + 1 + i * 37 % 61) % slots.size()]);
            double sum = 0;
            for (int k = 0; k < group.symbol_length(); k++)
                sum += std::norm(a[k] - b[k]);
            values.push_back(sum / (2 * group.symbol_length()));
        }
        return sorted_at(values, .97);
    }

    const int d_length;
    narrow_band_screen d_narrow_band;
    levels d_smallest, d_largest, d_edges;
};

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

    void fill(phase_group& group, int index)
    {
        group.clear();
        fc32* slot = group.reserve(0);
        snapshot_noise* noise = group.noise();
        const float level = d_which == room::rising && index > 5 ? 0.01f * index : 0.01f;
        for (int n = 0; n < d_length; n++, slot += 64) {
            const bool hit = d_which != room::quiet && d_which != room::tags &&
                             std::uniform_int_distribution(0, 19)(d_random) == 0;
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
        if (d_which == room::lost)
            slot[-64] = std::numeric_limits<float>::quiet_NaN();
        group.accept(d_length);
        group.finish();
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

} // namespace

BOOST_DATA_TEST_CASE(marks_are_those_of_the_plain_rule,
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
    plain_screen plain(length);
    phase_group group(length);
    int marked = 0;
    for (int index = 0; index < 12; index++) {
        simulated.fill(group, index);
        const auto want = plain.examine(group);
        const auto& found = screen.examine(group);
        BOOST_TEST(found == want, boost::test_tools::per_element());
        BOOST_TEST(screen.rejected() == std::count(want.begin(), want.end(), 1));
        marked += screen.rejected();
    }
    const bool is_quiet = which == room::quiet || which == room::tags;
    BOOST_TEST((marked > 0) == !is_quiet);
}
