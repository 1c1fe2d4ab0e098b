// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Turn and gain of the receiver from group to group, which all subcarriers of the static
// path have in common. It lies tens of dB above the tag. A step of the receiver changes
// it and the tag alike; what somebody changes who walks by differs from subcarrier to
// subcarrier.
class receiver_steps
{
public:
    explicit receiver_steps(double group_period_s);

    // A group as it was received: K subcarriers, E ends, two of each tag.
    struct group {
        const complex* static_path;    // K; 0 where it was not received
        const complex* ratios;         // E
        const double* reference_power; // E
        const bool* locked;            // E / 2
        std::size_t subcarriers, ends;
    };

    // Change since the last group that was received: turn in rad, gain in Np, and the
    // variance of each while the receiver does not step.
    struct change {
        double turn, gain, variance;
    };
    change next(const group& of);

    // Of a group whose static path is not known.
    static change none();

private:
    const double d_share;
    std::vector<complex> d_static, d_ratios; // of the last group that was received
    double d_power = 0, d_variance;          // of a turn and a gain
};

} // namespace gr::wiforce::kernel
