// SPDX-License-Identifier: GPL-3.0-or-later
// Interference that has the tag's own profile over the subcarriers, seen in the residual.
//
// The average over K subcarriers reduces independent noise by K. Leakage of movers,
// another tag, or an error of the clock is coherent over all of them, and is not reduced
// at all. What counts for the phase of an end is the residual's component along that
// end's channel, c_m = sum_k E_mk conj(V_k) / sigma_k^2: noise alone leaves sum_k |V_k|^2
// / sigma_k^2 of it on every tone.
#pragma once

#include "end_fit.h"

#include <cstddef>
#include <deque>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

// Factor by which the variance of each end exceeds that of independent noise: the
// sandwich estimate in the median of the last groups. A sudden rise in a single group is
// noticed by the mean of all tones, which fewer groups determine.
class coherent_residual
{
public:
    // Of E ends of some groups: the factor, at least 1, and whether something is received
    // on the lines of the end that is no noise.
    struct result {
        std::vector<double> factor;
        std::vector<char> disturbed;
    };

    // `ends`: of all tags.
    explicit coherent_residual(std::size_t ends) : d_medians(ends) {}

    // Forgets the groups so far, when the clocks were acquired again.
    void reset();

    // Takes the fit of some groups. `rows`: of the ends that were fitted, among those of
    // all tags; `inverse_noise`: 1 / sigma_k^2, K of each group.
    result update(const end_fit& fit,
                  const std::vector<std::size_t>& rows,
                  const double* inverse_noise);

private:
    // Median of the last groups that are finite, and their number.
    class running_median
    {
    public:
        std::pair<double, std::size_t> update(double value);

    private:
        std::deque<double> d_latest;
        std::vector<double> d_sorted;
    };

    std::vector<running_median> d_medians;
};

} // namespace gr::wiforce::kernel
