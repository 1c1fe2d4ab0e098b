// SPDX-License-Identifier: GPL-3.0-or-later
#include "channel_equalizer.h"

#include "require.h"

#include <cmath>

namespace gr::wiforce::kernel {

channel_equalizer::channel_equalizer(const std::vector<std::complex<double>>& factors)
{
    const char* where = "ofdm_channel_estimator";
    require(factors.size() == FFT_LENGTH,
            where,
            "factors",
            "must hold 64 values",
            std::to_string(factors.size()) + " values");
    for (int k = 0; k < FFT_LENGTH; k++) {
        require(std::isfinite(factors[k].real()) && std::isfinite(factors[k].imag()),
                where,
                "factors",
                "must be finite",
                factors[k]);
        d_factors[k] = fc32(factors[k]);
    }
}

void channel_equalizer::equalize(const fc32* spectrum, fc32* channel) const
{
    // Written out: the operator of std::complex tests for NaN and infinity.
    for (int k = 0; k < FFT_LENGTH; k++) {
        const float a = spectrum[k].real(), b = spectrum[k].imag();
        const float c = d_factors[k].real(), d = d_factors[k].imag();
        channel[k] = fc32(a * c - b * d, a * d + b * c);
    }
}

} // namespace gr::wiforce::kernel
