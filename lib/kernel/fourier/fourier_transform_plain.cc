// SPDX-License-Identifier: GPL-3.0-or-later
// Takes the place of fourier_transform.cc in builds without FFTW.
#include "fourier_transform.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace gr::wiforce::kernel {

namespace {

using value = std::complex<double>;

// As the standard library multiplies without its search for infinities and NaN.
value product(const value& a, const value& b)
{
    return { a.real() * b.real() - a.imag() * b.imag(),
             a.real() * b.imag() + a.imag() * b.real() };
}

} // namespace

// Decimation in time by the prime factors of the length (Cooley and Tukey, 1965), in
// double precision, so that the result differs from the exact transform by the rounding
// to float only.
struct fourier_transform::plan {
    explicit plan(int length)
        : input(length), output(length), d_length(length), d_roots(length), d_sums(length)
    {
        for (int n = 0; n < length; n++)
            d_roots[n] = std::polar(1.0, -2.0 * std::acos(-1.0) * n / length);
        int rest = length;
        for (int radix = 2; rest > 1; radix++)
            for (; rest % radix == 0; rest /= radix)
                d_radices.push_back(radix);
        d_butterfly.resize(d_radices.empty() ? 1 : d_radices.back());
    }

    void execute()
    {
        transform(input.data(), 1, d_length, d_radices.data(), d_sums.data());
        std::copy(d_sums.begin(), d_sums.end(), output.begin());
    }

    std::vector<fc32> input, output;

private:
    // Transforms the values from[0], from[stride], ... into out[0 .. length - 1].
    void transform(const fc32* from, int stride, int length, const int* radix, value* out)
    {
        if (length == 1) {
            *out = *from;
            return;
        }
        const int parts = *radix, part = length / parts;
        for (int r = 0; r < parts; r++)
            transform(from + r * stride, stride * parts, part, radix + 1, out + r * part);
        for (int k = 0; k < part; k++) {
            for (int r = 0; r < parts; r++)
                d_butterfly[r] = product(out[k + r * part], d_roots[k * r * stride]);
            if (parts == 2) {
                out[k] = d_butterfly[0] + d_butterfly[1];
                out[k + part] = d_butterfly[0] - d_butterfly[1];
                continue;
            }
            for (int q = 0; q < parts; q++) {
                value sum = d_butterfly[0];
                for (int r = 1; r < parts; r++)
                    sum += product(d_butterfly[r],
                                   d_roots[q * r % parts * (d_length / parts)]);
                out[k + q * part] = sum;
            }
        }
    }

    const int d_length;
    std::vector<int> d_radices;
    std::vector<value> d_roots; // exp(-2 pi j n / length)
    std::vector<value> d_butterfly;
    std::vector<value> d_sums;
};

fourier_transform::fourier_transform(int length)
    : d_length(length), d_plan(std::make_unique<plan>(length))
{
}

fourier_transform::~fourier_transform() = default;

fc32* fourier_transform::input() { return d_plan->input.data(); }

const fc32* fourier_transform::execute()
{
    d_plan->execute();
    return d_plan->output.data();
}

} // namespace gr::wiforce::kernel
