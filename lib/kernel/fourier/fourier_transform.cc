// SPDX-License-Identifier: GPL-3.0-or-later
#include "fourier_transform.h"

#ifdef WIFORCE_FFTW
#include <fftw3.h>

#include <map>
#include <mutex>
#else
#include <algorithm>
#include <cmath>
#endif

namespace gr::wiforce::kernel {

namespace {

#ifdef WIFORCE_FFTW

// One plan of a length serves all vectors, which are aligned alike, until the process
// ends. FFTW's planner belongs to the whole process, where GNU Radio plans as well.
auto transform_of(int length, fc32* input, fc32* output)
{
    static std::mutex one_at_a_time;
    static auto& plans = *new std::map<int, fftwf_plan>;
    const std::lock_guard lock(one_at_a_time);
    if (plans.empty()) {
        fftwf_init_threads();
        fftwf_make_planner_thread_safe();
    }
    const auto values = [](fc32* of) { return reinterpret_cast<fftwf_complex*>(of); };
    auto& plan = plans[length];
    if (!plan) {
        fftwf_plan_with_nthreads(1);
        plan = fftwf_plan_dft_1d(
            length, values(input), values(output), FFTW_FORWARD, FFTW_ESTIMATE);
    }
    return [plan = plan, values](fc32* input, fc32* output) {
        fftwf_execute_dft(plan, values(input), values(output));
    };
}

#else

using value = std::complex<double>;

// As the standard library multiplies without its search for infinities and NaN.
value product(const value& a, const value& b)
{
    return { a.real() * b.real() - a.imag() * b.imag(),
             a.real() * b.imag() + a.imag() * b.real() };
}

// Decimation in time by the prime factors of the length (Cooley and Tukey, 1965), in
// double precision, so that the result differs from the exact transform by the rounding
// to float only.
class prime_factors
{
public:
    explicit prime_factors(int length) : d_length(length), d_roots(length), d_sums(length)
    {
        for (int n = 0; n < length; n++)
            d_roots[n] = std::polar(1.0, -2.0 * std::acos(-1.0) * n / length);
        int rest = length;
        for (int radix = 2; rest > 1; radix++)
            for (; rest % radix == 0; rest /= radix)
                d_radices.push_back(radix);
        d_butterfly.resize(d_radices.empty() ? 1 : d_radices.back());
    }

    void operator()(const fc32* input, fc32* output)
    {
        transform(input, 1, d_length, d_radices.data(), d_sums.data());
        std::copy(d_sums.begin(), d_sums.end(), output);
    }

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

auto transform_of(int length, fc32*, fc32*) { return prime_factors(length); }

#endif

} // namespace

fourier_transform::fourier_transform(int length)
    : d_length(length),
      d_input((length + 1) / 2),
      d_output((length + 1) / 2),
      d_transform(transform_of(length, input(), output()))
{
}

} // namespace gr::wiforce::kernel
