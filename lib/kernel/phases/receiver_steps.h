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
    struct static_path {
        std::vector<complex> path; // K
        double power = 0;          // of all

        complex over(const static_path& other) const; // by least squares
    };
    static static_path path_of(const group& of);

    const double d_share;
    // Of the last group that was received: most of whose path is that of the one before
    // it, or of the group just before (a new path counts when it is seen again). Noise on
    // many subcarriers is neither.
    static_path d_static;
    std::vector<complex> d_ratios;
    static_path d_before; // of the last group
    double d_variance;    // of a turn and a gain
};

} // namespace gr::wiforce::kernel
