// SPDX-License-Identifier: GPL-3.0-or-later
#include "mixed_radix.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

// As the standard library multiplies without its search for infinities and NaN.
std::complex<double> product(const std::complex<double>& a, const std::complex<double>& b)
{
    return { a.real() * b.real() - a.imag() * b.imag(),
             a.real() * b.imag() + a.imag() * b.real() };
}

} // namespace

mixed_radix::mixed_radix(int length) : d_length(length), d_roots(length), d_output(length)
{
    for (int n = 0; n < length; n++)
        d_roots[n] = std::polar(1.0, -2.0 * std::acos(-1.0) * n / length);
    int rest = length;
    for (int radix = 2; rest > 1; radix++)
        for (; rest % radix == 0; rest /= radix)
            d_radices.push_back(radix);
    d_butterfly.resize(d_radices.empty() ? 1 : d_radices.back());
}

void mixed_radix::execute(const fc32* input, fc32* output)
{
    transform(input, 1, d_length, d_radices.data(), d_output.data());
    std::copy(d_output.begin(), d_output.end(), output);
}

void mixed_radix::transform(
    const fc32* input, int stride, int length, const int* radix, value* out)
{
    if (length == 1) {
        *out = *input;
        return;
    }
    const int parts = *radix, part = length / parts;
    for (int r = 0; r < parts; r++)
        transform(input + r * stride, stride * parts, part, radix + 1, out + r * part);
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
                sum +=
                    product(d_butterfly[r], d_roots[q * r % parts * (d_length / parts)]);
            out[k + q * part] = sum;
        }
    }
}

} // namespace gr::wiforce::kernel
