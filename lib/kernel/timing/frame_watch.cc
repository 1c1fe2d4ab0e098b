// SPDX-License-Identifier: GPL-3.0-or-later
#include "frame_watch.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// Shares of the energy, by the squared correlation of two averages. Movement or an added
// path leaves at least IN_PLACE at the same sample; a shift by one of the preamble's five
// repetitions leaves 0.64. Averages that correlate by SAME show the same frames.
constexpr float IN_PLACE = 0.7f;
constexpr float SAME = 0.8f;

// |<a, b>|^2
float match(const std::vector<fc32>& a, const std::vector<fc32>& b)
{
    float real = 0, imag = 0;
    for (std::size_t i = 0; i < a.size(); i++) {
        real += a[i].real() * b[i].real() + a[i].imag() * b[i].imag();
        imag += a[i].imag() * b[i].real() - a[i].real() * b[i].imag();
    }
    return real * real + imag * imag;
}

} // namespace

frame_watch::frame_watch(int frame_length, std::uint64_t origin)
    : d_length(frame_length),
      d_origin(origin),
      d_begin(origin),
      d_sum(frame_length),
      d_fourier(frame_length)
{
}

// The average, of unit energy and without its mean, since a DC offset is no part of a
// frame; empty when there is no signal.
frame_watch::profile frame_watch::average() const
{
    profile now = d_sum;
    fc32 mean = 0;
    for (const fc32& value : now)
        mean += value / float(d_length);
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
    std::fill(d_sum.begin(), d_sum.end(), fc32());
    d_begin += (settled ? PERIOD : AVERAGED) * d_length;
    return shift;
}

int frame_watch::judge(const profile& now)
{
    if (d_reference.empty())
        d_reference = d_candidate = now;
    if (match(now, d_reference) > IN_PLACE) {
        d_reference = d_candidate;
        d_candidate = now;
        d_mismatch.clear();
        return 0;
    }
    d_candidate = d_reference;
    const bool steady = !d_mismatch.empty() && match(now, d_mismatch) > SAME;
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

// By the correlation at all cyclic shifts; 0 when there is none.
int frame_watch::find_shift(const profile& now)
{
    const auto transformed = [&](const profile& of) {
        std::copy(of.begin(), of.end(), d_fourier.input());
        const fc32* const found = d_fourier.execute();
        return profile(found, found + d_length);
    };
    profile product = transformed(now);
    const profile reference = transformed(d_reference);
    for (std::uint64_t k = 0; k < d_length; k++)
        product[k] = std::conj(product[k]) * reference[k];
    const profile correlation = transformed(product); // conjugate, times the length
    float best = SAME * d_length * d_length;
    int shift = 0;
    for (std::uint64_t i = 1; i < d_length; i++)
        if (const float value = std::norm(correlation[i]); value > best) {
            best = value;
            shift = i;
        }
    return shift;
}

void frame_watch::restart(std::uint64_t position)
{
    const std::uint64_t past = position > d_origin ? position - d_origin : 0;
    d_begin = d_origin + (past + d_length - 1) / d_length * d_length;
    std::fill(d_sum.begin(), d_sum.end(), fc32());
}

} // namespace gr::wiforce::kernel
