// SPDX-License-Identifier: GPL-3.0-or-later
#include "channel_equalizer.h"

#include "../require.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

static const char* where = "ofdm_channel_estimator";

static std::vector<fc32> checked(const char* parameter,
                                 const std::vector<std::complex<double>>& values,
                                 size_t length)
{
    require(values.size() == length,
            where,
            parameter,
            "must hold " + std::to_string(length) + " values",
            std::to_string(values.size()) + " values");
    std::vector<fc32> result;
    for (const auto& value : values) {
        require(std::isfinite(value.real()) && std::isfinite(value.imag()),
                where,
                parameter,
                "must be finite",
                value);
        result.emplace_back(value);
    }
    return result;
}

// Written out: the operator of std::complex tests for NaN and infinity.
static void multiply(const fc32* x, const fc32* y, fc32* product)
{
    for (int k = 0; k < FFT_LENGTH; k++) {
        const float a = x[k].real(), b = x[k].imag();
        const float c = y[k].real(), d = y[k].imag();
        product[k] = fc32(a * c - b * d, a * d + b * c);
    }
}

channel_equalizer::channel_equalizer(const std::vector<std::complex<double>>& factors,
                                     int rows,
                                     const std::vector<std::complex<double>>& rotation)
    : d_rows(rows), d_factors(checked("factors", factors, FFT_LENGTH))
{
    require(rows >= 1, where, "rows", "must be >= 1", rows);
    if (!rotation.empty()) {
        d_rotation = checked("rotation", rotation, size_t(rows) * FFT_LENGTH);
    }
}

void channel_equalizer::rotate(int row, const fc32* samples, fc32* rotated) const
{
    if (d_rotation.empty()) {
        std::copy_n(samples, FFT_LENGTH, rotated);
    } else {
        multiply(samples, &d_rotation[row * FFT_LENGTH], rotated);
    }
}

void channel_equalizer::equalize(const fc32* spectrum, fc32* channel) const
{
    multiply(spectrum, d_factors.data(), channel);
}

} // namespace gr::wiforce::kernel
