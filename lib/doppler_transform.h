// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/doppler/phase_group.h"
#include "kernel/doppler/tone_accumulator.h"
#include <gnuradio/fft/fft.h>

namespace gr::wiforce {

// What a phase group becomes: rows() x 64 values.
class doppler_transform
{
public:
    virtual ~doppler_transform() = default;
    virtual int rows() const = 0;
    virtual void clear() = 0;
    // Works ahead on the slots decided so far.
    virtual void advance(const kernel::phase_group& group) = 0;
    // Of a finished group with at least one snapshot.
    virtual void finish(const kernel::phase_group& group, kernel::fc32* out) = 0;
};

class doppler_tones : public doppler_transform
{
public:
    doppler_tones(const std::vector<std::complex<double>>& weights, int group_length)
        : d_tones(weights, group_length)
    {
    }
    int rows() const override { return d_tones.tones(); }
    void clear() override { d_tones.clear(); }
    void advance(const kernel::phase_group& group) override { d_tones.advance(group); }
    void finish(const kernel::phase_group& group, kernel::fc32* out) override
    {
        d_tones.advance(group);
        d_tones.tones_of(group, out);
    }

private:
    kernel::tone_accumulator d_tones;
};

class doppler_spectrum : public doppler_transform
{
public:
    // Throws std::invalid_argument unless group_length >= 1.
    explicit doppler_spectrum(int group_length);
    int rows() const override { return d_fft.inbuf_length(); }
    void clear() override {}
    void advance(const kernel::phase_group&) override {}
    void finish(const kernel::phase_group& group, kernel::fc32* out) override;

private:
    gr::fft::fft_complex_fwd d_fft;
};

} // namespace gr::wiforce
