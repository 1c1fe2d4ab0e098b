// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <memory>

namespace gr::wiforce::kernel {

/*
 * The discrete Fourier transform of one length, X[k] = sum_n x[n] exp(-2 pi j k n / N).
 *
 * By FFTW, or in plain C++ where the build has no FFTW. FFTW's plan is chosen by rule and
 * not by measuring, so that every run rounds alike.
 */
class fourier_transform
{
public:
    // length >= 1.
    explicit fourier_transform(int length);
    ~fourier_transform();
    fourier_transform(const fourier_transform&) = delete;
    fourier_transform& operator=(const fourier_transform&) = delete;

    int length() const { return d_length; }
    // Where the next execute() finds x.
    fc32* input();
    // X, valid until the next call.
    const fc32* execute();

private:
    struct plan;
    const int d_length;
    const std::unique_ptr<plan> d_plan;
};

} // namespace gr::wiforce::kernel
