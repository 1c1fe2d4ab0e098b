// SPDX-License-Identifier: GPL-3.0-or-later
#include "frame_watch.h"

#include "../require.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

// Shares of the energy, by the squared correlation of two averages. Movement or an added
// path leaves at least IN_PLACE at the same sample; a shift by one of the preamble's five
// repetitions leaves 0.64. Averages that correlate by SAME show the same frames.
constexpr float IN_PLACE = 0.7f;
constexpr float SAME = 0.8f;

// Shifts of long frames at which the whole is compared. A part of the preamble is found
// at each of its repetitions, and a chirp at some samples beside each.
constexpr std::size_t COMPARED = 256;

// <a, b>, summed over pieces.
struct product {
    float real = 0;
    float imag = 0;

    void add(const fc32* a, const fc32* b, std::size_t count)
    {
        for (std::size_t i = 0; i < count; i++) {
            real += a[i].real() * b[i].real() + a[i].imag() * b[i].imag();
            imag += a[i].imag() * b[i].real() - a[i].real() * b[i].imag();
        }
    }
    float power() const { return real * real + imag * imag; }
};

// |<a, b>|^2 of unit vectors, b delayed by `shift` samples.
float match(const std::vector<fc32>& a, const std::vector<fc32>& b, std::size_t shift)
{
    product sum;
    sum.add(a.data() + shift, b.data(), a.size() - shift);
    sum.add(a.data(), b.data() + a.size() - shift, shift);
    return sum.power();
}

} // namespace

frame_watch::frame_watch(int frame_length, std::uint64_t origin)
    : d_length(frame_length),
      d_is_active(frame_length <= LONGEST_FRAME),
      d_origin(origin),
      d_begin(origin)
{
    require(
        frame_length >= 1, "frame_watch", "frame_length", "must be >= 1", frame_length);
    if (d_is_active)
        d_sum.assign(2 * d_length, 0.0f);
}

template <class Sample>
void frame_watch::take(const Sample* samples, std::uint64_t count, std::uint64_t position)
{
    if (!d_is_active)
        return;
    const std::uint64_t end = position + count;
    const auto* parts = reinterpret_cast<const typename Sample::value_type*>(samples);
    for (std::uint64_t at = std::max(position, d_begin); at < end;) {
        const std::uint64_t place = (at - d_begin) % d_length;
        const std::uint64_t run = std::min(d_length - place, end - at);
        const auto* in = parts + 2 * (at - position);
        float* sum = d_sum.data() + 2 * place;
        for (std::uint64_t i = 0; i < 2 * run; i++)
            sum[i] += in[i];
        at += run;
    }
}

template void frame_watch::take(const fc32*, std::uint64_t, std::uint64_t);
template void frame_watch::take(const sc16*, std::uint64_t, std::uint64_t);

// The average, of unit energy and without its mean, since a DC offset is no part of a
// frame; empty when there is no signal.
frame_watch::profile frame_watch::average() const
{
    profile now(d_length);
    fc32 mean = 0;
    for (std::uint64_t i = 0; i < d_length; i++) {
        now[i] = { d_sum[2 * i], d_sum[2 * i + 1] };
        mean += now[i] / float(d_length);
    }
    float energy = 0;
    for (fc32& value : now) {
        value -= mean;
        energy += std::norm(value);
    }
    if (!std::isnormal(energy))
        return {};
    const float scale = 1 / std::sqrt(energy);
    for (fc32& value : now)
        value *= scale;
    return now;
}

int frame_watch::decide()
{
    const profile now = average();
    const int shift = now.empty() ? 0 : judge(now);
    d_searching = d_mismatch.empty() ? 0 : d_searching + 1;
    // A loss within an average shows in the next two; noise never matches.
    const bool settled = d_searching % LONGEST_SEARCH == 0;
    std::fill(d_sum.begin(), d_sum.end(), 0.0f);
    d_begin += (settled ? PERIOD : AVERAGED) * d_length;
    return shift;
}

int frame_watch::judge(const profile& now)
{
    if (d_reference.empty())
        d_reference = d_candidate = now;
    if (match(now, d_reference, 0) > IN_PLACE) {
        d_reference = d_candidate;
        d_candidate = now;
        d_mismatch.clear();
        return 0;
    }
    d_candidate = d_reference;
    const bool steady = !d_mismatch.empty() && match(now, d_mismatch, 0) > SAME;
    d_mismatch = now;
    if (!steady)
        return 0;
    const int shift = find_shift(now);
    // Without a shift the channel changed, and the frames are still on the grid.
    if (shift == 0)
        d_reference = d_candidate = now;
    d_mismatch.clear();
    return shift;
}

// 0 when there is none.
int frame_watch::find_shift(const profile& now) const
{
    float best = SAME;
    int shift = 0;
    for (const std::uint64_t i : likely_shifts(now)) {
        const float value = match(now, d_reference, i);
        if (value > best) {
            best = value;
            shift = i;
        }
    }
    return shift;
}

// All shifts of a frame of up to LONGEST_WHOLE samples; of a longer one those at which
// the part of the reference with most energy is most similar.
std::vector<std::uint64_t> frame_watch::likely_shifts(const profile& now) const
{
    std::vector<std::uint64_t> shifts(d_length - 1);
    std::iota(shifts.begin(), shifts.end(), 1);
    if (d_length <= LONGEST_WHOLE || shifts.size() <= COMPARED)
        return shifts;
    const std::uint64_t part = LONGEST_WHOLE * std::uint64_t(LONGEST_WHOLE) / d_length;
    std::uint64_t first = 0;
    float most = 0;
    for (std::uint64_t start = 0; start + part <= d_length; start += part) {
        float energy = 0;
        for (std::uint64_t i = start; i < start + part; i++)
            energy += std::norm(d_reference[i]);
        if (energy > most) {
            most = energy;
            first = start;
        }
    }
    profile twice(now);
    twice.insert(twice.end(), now.begin(), now.end());
    std::vector<float> found(d_length);
    for (const std::uint64_t shift : shifts) {
        product sum;
        sum.add(&twice[first + shift], &d_reference[first], part);
        found[shift] = sum.power();
    }
    std::partial_sort(shifts.begin(),
                      shifts.begin() + COMPARED,
                      shifts.end(),
                      [&](auto a, auto b) { return found[a] > found[b]; });
    shifts.resize(COMPARED);
    return shifts;
}

void frame_watch::restart(std::uint64_t position)
{
    const std::uint64_t past = position > d_origin ? position - d_origin : 0;
    d_begin = d_origin + (past + d_length - 1) / d_length * d_length;
    std::fill(d_sum.begin(), d_sum.end(), 0.0f);
}

} // namespace gr::wiforce::kernel
