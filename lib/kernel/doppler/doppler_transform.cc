// SPDX-License-Identifier: GPL-3.0-or-later
#include "doppler_transform.h"

#include "../require.h"

namespace gr::wiforce::kernel {

namespace {

int checked(int group_length)
{
    require(group_length >= 1,
            "phase_group_doppler",
            "group_length",
            "must be >= 1",
            group_length);
    return group_length;
}

} // namespace

doppler_spectrum::doppler_spectrum(int group_length) : d_fft(checked(group_length)) {}

// As in tone_accumulator, differences from the first snapshot are transformed and that
// snapshot is added back, so that a static path does not round into the other bins.
void doppler_spectrum::transform(const phase_group& group, fc32* out)
{
    const int length = rows();
    const float scale = 1.0f / length;
    const fc32* reference = group.reference();
    const int width = group.symbol_length();
    for (int k = 0; k < width; k++) {
        for (int n = 0; n < length; n++)
            d_fft.input()[n] = group.slot(n)[k] - reference[k];
        const fc32* spectrum = d_fft.execute();
        for (int m = 0; m < length; m++)
            out[std::size_t(m) * width + k] = scale * spectrum[m];
    }
    for (int n = 0; n < length; n++)
        d_fft.input()[n] = group.mask()[n];
    const fc32* mask = d_fft.execute();
    for (int m = 0; m < length; m++) {
        // A complete group's mask is constant: exactly zero outside bin 0.
        const fc32 weight =
            group.is_complete() ? fc32(m == 0 ? 1.0f : 0.0f) : scale * mask[m];
        for (int k = 0; k < width; k++)
            out[std::size_t(m) * width + k] += weight * reference[k];
    }
}

} // namespace gr::wiforce::kernel
