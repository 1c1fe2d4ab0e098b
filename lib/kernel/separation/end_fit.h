// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Least-squares fit of the tags' ends to the whitened parts of the tones of some groups
// (`group_weights.h`), each by itself: tones = mixing x ends + residual (docs/theory.md,
// Ends). Arrays hold the groups one after the other, matrices row by row.
class end_fit
{
public:
    // Sizes: groups, tones M (an even number), ends E of the tags that are fitted, two
    // each, and subcarriers K.
    struct shape {
        std::size_t groups, tones, ends, subcarriers;
    };

    // `mixed`: M x 2E of every group, the tags' waveforms as whitened tones, and behind
    // them their derivatives by the clocks' phases. `tones`: M x K, whitened.
    end_fit(const shape& sizes, const double* mixed, const complex* tones);

    // Fits other tones of the same groups at the same clocks.
    void solve(const complex* tones);

    const shape sizes;
    std::vector<double> mixing, slopes; // M x E
    std::vector<double> solver;         // E x M, the pseudo-inverse of the mixing
    std::vector<double> gain;           // E: variance of an end over that of H
    std::vector<complex> ends;          // E x K
    std::vector<complex> residual;      // M x K

    // Degrees of freedom of the residual of a group on one subcarrier.
    std::size_t freedom() const;

    // Sum of the squared residual over the tones, K of each group.
    std::vector<double> power() const;

private:
    void invert(); // the mixing
};

} // namespace gr::wiforce::kernel
