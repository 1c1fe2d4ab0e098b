// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cmath>
#include <optional>

namespace gr::wiforce::kernel {

/*
 * The sample rate and carrier of a stream, as the device reports them: samples of others
 * are not to be used.
 *
 * The carrier is the first one reported; where one is expected, the first that is close
 * to it. One thread notes reports, any may ask for those that are refused.
 */
class device_settings
{
public:
    explicit device_settings(double sample_rate) : d_sample_rate(sample_rate) {}

    // The carrier that the next one reported must be close to, which then holds.
    void expect_carrier(double frequency_hz)
    {
        d_expected = frequency_hz;
        d_carrier.reset();
    }

    void note_rate(double rate)
    {
        d_rate_is_right = std::abs(rate - d_sample_rate) <= 1e-6 * d_sample_rate;
        d_refused_rate = d_rate_is_right ? 0 : rate;
    }
    void note_carrier(double frequency_hz)
    {
        d_carrier_is_right = is_right(frequency_hz);
        if (d_carrier_is_right && !d_carrier)
            d_carrier = frequency_hz;
        d_refused_carrier = d_carrier_is_right ? 0 : frequency_hz;
    }

    // Whether the samples that follow have both.
    bool usable() const { return d_rate_is_right && d_carrier_is_right; }
    double sample_rate() const { return d_sample_rate; }
    // Of the samples that are used; 0 where none is known.
    double carrier() const { return d_carrier.value_or(d_expected.value_or(0.0)); }

    // Those that were reported last, 0 where they are right.
    double refused_rate() const { return d_refused_rate; }
    double refused_carrier() const { return d_refused_carrier; }

private:
    // A carrier given within this fraction of a sensor model's is taken for it.
    static constexpr double CARRIER_TOLERANCE = 1e-3;

    bool is_right(double frequency_hz) const
    {
        if (d_carrier || !d_expected)
            return std::abs(frequency_hz - d_carrier.value_or(frequency_hz)) <= 1;
        return std::abs(frequency_hz - *d_expected) <= CARRIER_TOLERANCE * *d_expected;
    }

    const double d_sample_rate;
    std::optional<double> d_expected, d_carrier;
    bool d_rate_is_right = true, d_carrier_is_right = true;
    std::atomic<double> d_refused_rate = 0, d_refused_carrier = 0;
};

} // namespace gr::wiforce::kernel
