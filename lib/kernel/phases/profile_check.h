// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Removes the receiver's mirror image from the channels of E ends on K subcarriers, and
// compares the rest with those of the untouched sensor on D other delay profiles.
class profile_check
{
public:
    using channel = std::vector<std::complex<double>>;

    profile_check(std::size_t ends, std::size_t subcarriers);

    std::size_t ends() const { return d_means.size(); }
    std::size_t subcarriers() const { return d_subcarriers; }

    // Channels of the untouched sensor and their images, E x K each, and the conjugate of
    // other delay profiles, E x D x K: orthonormal, and orthogonal to the channel.
    void set_reference(channel reference, channel image, channel other);

    // Forgets the groups so far, for a new reference.
    void reset();

    // What a group is compared by: K each, but for the gain.
    struct group {
        const double* weights; // of sum 1
        const double* noise;   // variance of H
        const double* raised;  // subcarriers that count less; null where none is
        const double* gain;    // E, variance of V - R V_ref over that of H
    };

    // Takes the channels of the next group, E x K, and removes the image from them. Gives
    // the factor (E), at least 1, by which the variance of R exceeds that of noise.
    std::vector<double> process(std::complex<double>* channels, const group& by);

private:
    double process_end(std::size_t end, std::complex<double>* channel, const group& by);
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

} // namespace gr::wiforce::kernel
