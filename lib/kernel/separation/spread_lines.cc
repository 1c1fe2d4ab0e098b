// SPDX-License-Identifier: GPL-3.0-or-later
#include "spread_lines.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

// A symbol that is received through a switch, of which each sample passes as far as it is
// on.
struct passing {
    std::vector<double> course; // M, before the step of the first sample
    std::vector<double> steps;  // N x M
    const complex* symbol;      // N
};

// Adds to samples (N x M, real and imaginary parts in rows of `width`) the symbols that
// two switches pass.
WIFORCE_CLONES
void add_passed(std::array<passing, 2>& of, std::size_t width, double* samples)
{
    auto& [first, second] = of;
    for (std::size_t from = 0; from < first.steps.size(); from += width) {
        const complex a = *first.symbol++, b = *second.symbol++;
        const double a_real = a.real(), a_imag = a.imag(), b_real = b.real(),
                     b_imag = b.imag();
        double *const now = first.course.data(), *const also = second.course.data();
        const double *const step = &first.steps[from], *const other = &second.steps[from];
        for (std::size_t tone = 0; tone < width; tone++) {
            const double x = now[tone] + step[tone], y = also[tone] + other[tone];
            now[tone] = x;
            also[tone] = y;
            samples[tone] += x * a_real + y * b_real;
            samples[width + tone] += x * a_imag + y * b_imag;
        }
        samples += 2 * width;
    }
}

// sum += factor x row
WIFORCE_CLONES
void add_row(double factor, const double* row, std::vector<double>& sum)
{
    for (double& each : sum)
        each += factor * *row++;
}

template <class T>
WIFORCE_CLONES void
multiply(const left_factor& left, const T* right, std::size_t columns, T* to)
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

// Samples (N x M, real and imaginary parts in rows of the weights' width) that symbols
// (E x N) leave in the parts.
std::vector<double> spread_lines::passed(const complex* symbols,
                                         std::size_t ends,
                                         const group_weights& weights,
                                         const switching_clock* clocks,
                                         const switching_pulses* pulses,
                                         const double* switched) const
{
    const std::size_t length = d_sources.size(), width = weights.width();
    std::vector<double> samples(2 * width * length);
    for (std::size_t tag = 0; tag < ends / 2; tag++) {
        std::array<passing, 2> both;
        for (std::size_t i = 0; i < 2; i++) {
            const std::size_t end = 2 * tag + i;
            auto& [course, steps, symbol] = both[i];
            symbol = symbols + end * length;
            steps = weights.steps(clocks[tag], pulses[tag], i, length, d_of.repetitions);
            course.resize(width);
            // The mean over the samples is that of the fit.
            for (std::size_t tone = 0; tone < weights.tones(); tone++)
                course[tone] = switched[tone * 2 * ends + end];
            for (std::size_t n = 0; n < length; n++)
                add_row(double(n) / length - 1, &steps[n * width], course);
        }
        add_passed(both, width, samples.data());
    }
    return samples;
}

// Subtracts from parts (M x K) the transforms of such samples, rotated as those of the
// tones were.
void spread_lines::subtract(const std::vector<double>& samples,
                            const group_weights& weights,
                            complex* parts)
{
    const std::size_t length = d_sources.size(), width = weights.width();
    std::vector<fc32> second(length);
    const auto subtract_transform = [&](std::size_t row) {
        const fc32* const found = d_fourier.execute();
        for (std::size_t k = 0; k < d_of.bins.size(); k++)
            parts[row * d_of.bins.size() + k] -=
                complex(found[d_of.bins[k]]) * d_of.factors[k];
    };
    for (std::size_t row = 0; row < weights.tones(); row += 2) {
        for (std::size_t n = 0; n < length; n++) {
            const double* const at = &samples[2 * width * n + row];
            complex a{ at[0], at[width] }, b{ at[1], at[width + 1] };
            if (!d_of.rotation.empty()) {
                const complex by = d_of.rotation[row / 2 * length + n];
                // (a + jb) by, and (a - jb) conj(by), which are its real and imaginary
                // parts where a and b are real.
                const complex rotated = by.real() * a - by.imag() * b;
                b = by.real() * b + by.imag() * a;
                a = rotated;
            }
            d_fourier.input()[n] = fc32(a);
            second[n] = fc32(b);
        }
        subtract_transform(row);
        std::copy(second.begin(), second.end(), d_fourier.input());
        subtract_transform(row + 1);
    }
}

void spread_lines::remove(const end_fit& fit,
                          std::size_t row,
                          const group_weights& weights,
                          const switching_clock* clocks,
                          const switching_pulses* pulses,
                          const double* switched,
                          complex* parts)
{
    const std::size_t count = fit.sizes.tones, subcarriers = fit.sizes.subcarriers,
                      each = fit.sizes.ends;
    std::vector<double> solver(each * count); // of parts
    multiply({ &fit.solver[row * solver.size()], each, count },
             weights.whitener().data(),
             count,
             solver.data());
    std::vector<complex> ends(each * subcarriers),
        rest(parts, parts + count * subcarriers);
    for (int round = 0; round < d_of.rounds; round++) {
        multiply({ solver.data(), each, count }, rest.data(), subcarriers, ends.data());
        std::copy_n(parts, rest.size(), rest.begin());
        const auto symbols = received(ends.data(), each);
        subtract(passed(symbols.data(), each, weights, clocks, pulses, switched),
                 weights,
                 rest.data());
    }
    multiply({ switched, count, each, 2 * each }, ends.data(), subcarriers, rest.data());
    std::copy(rest.begin(), rest.end(), parts);
}

} // namespace gr::wiforce::kernel
