// SPDX-License-Identifier: GPL-3.0-or-later
#include "preamble_folder.h"

#include "../require.h"
#include "phase_group.h"
#include "sample_loops.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <type_traits>

namespace gr::wiforce::kernel {

namespace {
// The last code of a 12-bit converter, left-justified; floats count from 1.
constexpr float FULL_SCALE = 32752 / 32768.0f;
// Drivers divide integers by 32767. What is larger was not limited by a converter.
constexpr float BEYOND = 1.0001f;
// Repetitions of the symbol in which a value may be alike by chance.
constexpr std::size_t LEAST_REPEATED = 8;

template <class Component>
float peak_of(const Component* parts, int count)
{
    Component low = 0, high = 0;
    for (int n = 0; n < count; n++) {
        low = std::min(low, parts[n]);
        high = std::max(high, parts[n]);
    }
    return std::max<float>(high, -float(low));
}

// Values that a component takes in all frames and repetitions, of which at most three
// are counted.
template <class Component>
int values_of(const repeated_symbols<Component>& of, const Component* component)
{
    const Component first = *component;
    Component other = first;
    for (std::size_t frame = 0; frame < of.frames; frame++)
        for (int n = 0; n < of.repetitions; n++) {
            const Component value = component[frame * of.stride + n * of.width];
            if (value != first && value != other) {
                if (other != first)
                    return 3;
                other = value;
            }
        }
    return other == first ? 1 : 2;
}

// Whether an amplifier or fewer bits limit the samples: noise, which gives three values
// or more to all other components, does not reach the largest.
template <class Component>
bool is_limited(const repeated_symbols<Component>& of, float peak)
{
    if (of.frames * of.repetitions < LEAST_REPEATED || peak == 0)
        return false;
    const auto is_largest = [=](Component part) { return std::abs(float(part)) >= peak; };
    const Component* const end = of.in + of.width;
    const Component* const largest = std::find_if(of.in, end, is_largest);
    if (largest == end || values_of(of, largest) > 1)
        return false;
    int reached = 0; // by noise
    for (const Component* part = of.in; part < end; part++) {
        const int values = values_of(of, part);
        const bool limited = values == 1 && std::abs(float(*part)) >= FULL_SCALE * peak;
        if (values < 3 && !limited)
            return false;
        reached += !limited;
    }
    return reached > 0;
}

} // namespace

preamble_folder::preamble_folder(int frame_length,
                                 int first_averaged,
                                 int repetitions,
                                 int symbol_length)
    : d_frame_length(frame_length),
      d_first_averaged(first_averaged),
      d_repetitions(repetitions),
      d_symbol_length(symbol_length)
{
    require(first_averaged >= 0,
            "preamble_fold: first_averaged must be >= 0",
            first_averaged);
    // Above 65536 repetitions the integer sums could overflow.
    require(repetitions >= 1 && repetitions <= 65536,
            "preamble_fold: repetitions must be 1 to 65536",
            repetitions);
    require_symbol_length(symbol_length, "preamble_fold");
    const long long end = first_averaged + 1LL * symbol_length * repetitions;
    require(frame_length >= end,
            "preamble_fold: frame_length must be >= first_averaged + " +
                std::to_string(symbol_length) + " repetitions = " + std::to_string(end),
            frame_length);
}

template <class Sample>
void preamble_folder::fold(const Sample* averaged,
                           std::size_t frames,
                           fc32* folded,
                           snapshot_noise* noise,
                           std::vector<int>& saturated) const
{
    using component = typename Sample::value_type;
    constexpr float one = std::is_integral_v<component> ? 32768 : 1; // what counts as 1
    const auto* const parts = reinterpret_cast<const component*>(averaged);
    const std::size_t stride = 2 * d_frame_length;
    const repeated_symbols<component> symbols{
        parts, stride, frames, d_repetitions, 2 * d_symbol_length
    };
    const float peak = fold_samples(symbols,
                                    1.0f / (one * d_repetitions),
                                    reinterpret_cast<float*>(folded),
                                    reinterpret_cast<float*>(noise));
    // NaN, infinity, or numbers whose sum may be infinite.
    if (!(peak < std::numeric_limits<float>::max() / d_repetitions))
        note_values_not_finite(folded, frames, d_symbol_length, noise);
    saturated.clear();
    // Not looked for beside a value that is not finite: the largest is unknown.
    if (peak < FULL_SCALE * one && is_limited(symbols, peak)) {
        saturated.resize(frames);
        std::iota(saturated.begin(), saturated.end(), 0);
    }
    for (std::size_t frame = 0; !(peak < FULL_SCALE * one) && frame < frames; frame++) {
        const float most = peak_of(parts + frame * stride, 2 * averaged_length());
        if (most >= FULL_SCALE * one && most <= BEYOND * one)
            saturated.push_back(frame);
    }
}

template void preamble_folder::fold(
    const fc32*, std::size_t, fc32*, snapshot_noise*, std::vector<int>&) const;
template void preamble_folder::fold(
    const sc16*, std::size_t, fc32*, snapshot_noise*, std::vector<int>&) const;

} // namespace gr::wiforce::kernel
