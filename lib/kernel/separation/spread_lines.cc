// SPDX-License-Identifier: GPL-3.0-or-later
#include "spread_lines.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// samples (M x N) = courses (N x E x M) times what is received (E x N).
WIFORCE_CLONES
void sum_ends(const double* courses,
              const complex* received,
              std::size_t ends,
              std::size_t tones,
              std::size_t length,
              complex* samples)
{
    std::vector<double> real(tones), imag(tones);
    for (std::size_t n = 0; n < length; n++) {
        std::fill(real.begin(), real.end(), 0.0);
        std::fill(imag.begin(), imag.end(), 0.0);
        for (std::size_t end = 0; end < ends; end++, courses += tones) {
            const complex value = received[end * length + n];
            for (std::size_t tone = 0; tone < tones; tone++) {
                real[tone] += courses[tone] * value.real();
                imag[tone] += courses[tone] * value.imag();
            }
        }
        for (std::size_t tone = 0; tone < tones; tone++)
            samples[tone * length + n] = { real[tone], imag[tone] };
    }
}

WIFORCE_CLONES
void multiply(const left_factor& left,
              const complex* right,
              std::size_t columns,
              complex* to)
{
    add_product(left, right, columns, to);
}

} // namespace

spread_lines::spread_lines(settings of)
    : d_of(std::move(of)), d_fourier(static_cast<int>(d_of.spectrum.size()))
{
    const int length = d_fourier.length();
    const auto outside = [length](int bin) { return bin < 0 || bin >= length; };
    if (d_of.bins.empty() || d_of.factors.size() != d_of.bins.size() ||
        std::any_of(d_of.bins.begin(), d_of.bins.end(), outside))
        throw std::invalid_argument(
            "spread_lines: bins must be of the spectrum, each with a factor");
    if (d_of.rotation.size() % length)
        throw std::invalid_argument("spread_lines: rotation must have a column a sample");
    if (d_of.repetitions < 1 || d_of.rounds < 1)
        throw std::invalid_argument(
            "spread_lines: repetitions and rounds must be 1 or more");
    std::vector<int> index(length, -1); // of the subcarrier of a bin
    for (std::size_t k = 0; k < d_of.bins.size(); k++)
        index[d_of.bins[k]] = static_cast<int>(k);
    // The channel of an unused subcarrier lies between those of the nearest used ones.
    for (int bin = 0; bin < length; bin++) {
        int down = 0, up = 0;
        while (index[(bin - down + length) % length] < 0)
            down++;
        while (index[(bin + up) % length] < 0)
            up++;
        d_sources.push_back({ std::size_t(index[(bin - down + length) % length]),
                              std::size_t(index[(bin + up) % length]),
                              down ? double(down) / (down + up) : 0.0 });
    }
}

// Samples (E x N) of a symbol from each of some ends (E x K).
std::vector<complex> spread_lines::received(const complex* ends, std::size_t count)
{
    const std::size_t length = d_sources.size(), subcarriers = d_of.bins.size();
    std::vector<complex> samples(count * length);
    for (std::size_t end = 0; end < count; end++, ends += subcarriers) {
        for (std::size_t bin = 0; bin < length; bin++) {
            const auto& [below, above, share] = d_sources[bin];
            const auto channel = ends[below] + share * (ends[above] - ends[below]);
            // Conjugates, twice, make the transform the inverse one.
            d_fourier.input()[bin] = fc32(std::conj(channel * d_of.spectrum[bin]));
        }
        const fc32* const found = d_fourier.execute();
        for (std::size_t n = 0; n < length; n++)
            samples[end * length + n] = std::conj(complex(found[n])) / double(length);
    }
    return samples;
}

// Rotates samples (M x N) of whitened parts as those of the tones were.
void spread_lines::unrotated_to_tones(const group_weights& weights,
                                      std::vector<complex>& samples)
{
    const std::size_t length = d_sources.size(), count = weights.tones();
    std::vector<complex> parts(samples.size());
    color(weights, samples.data(), length, parts.data());
    for (std::size_t pair = 0; pair < count / 2; pair++) {
        complex* const first = &parts[2 * pair * length];
        complex* const second = first + length;
        for (std::size_t n = 0; n < length; n++) {
            const complex by = d_of.rotation[pair * length + n];
            // (a + jb) by, and (a - jb) conj(by), which are its real and imaginary parts
            // where a and b are real.
            const complex a = first[n], b = second[n];
            first[n] = by.real() * a - by.imag() * b;
            second[n] = by.real() * b + by.imag() * a;
        }
    }
    whiten(weights.whitener().data(), parts.data(), count, length, samples.data());
}

// Whitened parts (M x K) that the ends cause, with what they spread.
std::vector<complex> spread_lines::tones_of(const complex* ends,
                                            const std::vector<double>& courses,
                                            const end_fit::shape& sizes,
                                            const group_weights& weights)
{
    const std::size_t length = d_sources.size(), count = sizes.tones;
    const auto symbols = received(ends, sizes.ends);
    std::vector<complex> samples(count * length), tones(count * sizes.subcarriers);
    sum_ends(courses.data(), symbols.data(), sizes.ends, count, length, samples.data());
    if (!d_of.rotation.empty())
        unrotated_to_tones(weights, samples);
    for (std::size_t tone = 0; tone < count; tone++) {
        std::copy_n(&samples[tone * length], length, d_fourier.input());
        const fc32* const found = d_fourier.execute();
        for (std::size_t k = 0; k < sizes.subcarriers; k++)
            tones[tone * sizes.subcarriers + k] =
                complex(found[d_of.bins[k]]) * d_of.factors[k];
    }
    return tones;
}

std::vector<complex> spread_lines::removed(const end_fit& fit,
                                           std::size_t row,
                                           const group_weights& weights,
                                           const switching_clock* clocks,
                                           const switching_pulses* pulses,
                                           const complex* white)
{
    const auto& sizes = fit.sizes;
    const std::size_t count = sizes.tones, subcarriers = sizes.subcarriers;
    const double* const mixing = &fit.mixing[row * count * sizes.ends];
    const double* const solver = &fit.solver[row * sizes.ends * count];
    const complex* const first = &fit.ends[row * sizes.ends * subcarriers];
    std::vector<complex> ends(first, first + sizes.ends * subcarriers);
    const auto courses = weights.courses(
        clocks, pulses, sizes.ends / 2, mixing, d_sources.size(), d_of.repetitions);
    for (int round = 1;; round++) {
        auto parts = tones_of(ends.data(), courses, sizes, weights);
        for (std::size_t i = 0; i < parts.size(); i++)
            parts[i] = white[i] - parts[i];
        if (round == d_of.rounds) {
            multiply(
                { mixing, count, sizes.ends }, ends.data(), subcarriers, parts.data());
            return parts;
        }
        multiply({ solver, sizes.ends, count }, parts.data(), subcarriers, ends.data());
    }
}

} // namespace gr::wiforce::kernel
