// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Channels V of E ends on K subcarriers in a group.
struct end_channels {
    complex* values;          // E x K
    const double* gain;       // E: variance of V over that of H, infinite without V
    const double* noise;      // K: variance of H
    const double* noise_rise; // K: the same over that before; null where not known
};

// What the ends are compared with.
struct reference_channels {
    const complex* values; // E x K
    const double* gain;    // E: variance over that of H, infinite without one
};

// Removes the receiver's mirror image from the channels of E ends on K subcarriers, and
// compares the rest with those of the untouched sensor on D other delay profiles.
class profile_check
{
public:
    using channel = std::vector<complex>;

    profile_check(std::size_t ends, std::size_t subcarriers);

    std::size_t ends() const { return d_means.size(); }
    std::size_t subcarriers() const { return d_subcarriers; }

    // Channels of the untouched sensor and their images, E x K each, and the conjugate of
    // other delay profiles, E x D x K: orthonormal, and orthogonal to the channel.
    void set_reference(channel reference, channel image, channel other);

    // Forgets the groups so far, for a new reference.
    void reset();

    // Takes the channel of an end in the next group, and removes the image from it. Gives
    // the factor, at least 1, by which the variance of R exceeds that of noise.
    // `weights`: K, of sum 1; `gain`: variance of V - R V_ref over that of H.
    double process(std::size_t end,
                   complex* channel,
                   const double* weights,
                   const end_channels& by,
                   double gain);

private:
    double factor(std::size_t end, double ratio);

    struct mean {
        double ratio = 1.0;
        std::size_t groups = 0;
    };

    const std::size_t d_subcarriers;
    channel d_reference, d_image, d_other, d_residual;
    std::vector<double> d_other_powers;
    std::vector<mean> d_means; // by end
};

// Where a group's ends are described against their reference.
struct difference {
    double* gain;   // E: of the ends, with deviations from the profile
    double* power;  // E: weighted mean of |V_ref|^2; 0 without a reference
    bool* reshaped; // E: varies over the subcarriers unlike its reference
};

// Replaces V by V conj(V_ref) over the reference's power, so that the weighted mean over
// the subcarriers is R. By the check, where there is one, images are removed before.
void conjugate_difference(const end_channels& ends,
                          const reference_channels& reference,
                          std::size_t end_count,
                          std::size_t subcarriers,
                          profile_check* check,
                          const difference& found);

} // namespace gr::wiforce::kernel
