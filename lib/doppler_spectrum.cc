// SPDX-License-Identifier: GPL-3.0-or-later
#include "doppler_transform.h"

#include "kernel/require.h"

namespace gr::wiforce {

static int checked(int group_length)
{
    kernel::require(group_length >= 1,
                    "phase_group_doppler",
                    "group_length",
                    "must be >= 1",
                    group_length);
    return group_length;
}

doppler_spectrum::doppler_spectrum(int group_length) : d_fft(checked(group_length)) {}

// As in tone_accumulator, differences from the first snapshot are transformed and that
// snapshot is added back, so that a static path does not round into the other bins.
void doppler_spectrum::finish(const kernel::phase_group& group, kernel::fc32* out)
{
    const int length = rows();
    const float scale = 1.0f / length;
    const kernel::fc32* reference = group.reference();
    for (int k = 0; k < kernel::FFT_LENGTH; k++) {
        for (int n = 0; n < length; n++)
            d_fft.get_inbuf()[n] = group.slot(n)[k] - reference[k];
        d_fft.execute();
        for (int m = 0; m < length; m++)
            out[m * kernel::FFT_LENGTH + k] = scale * d_fft.get_outbuf()[m];
    }
    for (int n = 0; n < length; n++)
        d_fft.get_inbuf()[n] = group.mask()[n];
    d_fft.execute();
    for (int m = 0; m < length; m++) {
        // A complete group's mask is constant: exactly zero outside bin 0.
        const kernel::fc32 weight = group.missing() == 0
                                        ? kernel::fc32(m == 0 ? 1.0f : 0.0f)
                                        : scale * d_fft.get_outbuf()[m];
        for (int k = 0; k < kernel::FFT_LENGTH; k++)
            out[m * kernel::FFT_LENGTH + k] += weight * reference[k];
    }
}

} // namespace gr::wiforce
