// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../doppler/switching_mixer.h"

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Weights that lead from the snapshots received of a group to its M tones.
class group_weights
{
public:
    // `mixed`: of whitened tones, a row for each snapshot; `times_s`: of the snapshots,
    // from the centre. `whitener`: lower triangular, M x M, makes the noise of tones
    // white. `loss`: snapshots of a group over those received.
    group_weights(const std::vector<double>& mixed,
                  const std::vector<double>& times_s,
                  std::vector<std::complex<double>> whitener,
                  double loss)
        : mixer(mixed, times_s), loss(loss), d_whitener(std::move(whitener))
    {
    }

    const switching_mixer mixer;
    const double loss;

    std::size_t tones() const { return mixer.columns() / 2; }

    const std::vector<std::complex<double>>& whitener() const { return d_whitener; }

    // Inverse of the whitener.
    const std::vector<std::complex<double>>& colorer() const;

private:
    const std::vector<std::complex<double>> d_whitener;
    mutable std::vector<std::complex<double>> d_colorer; // empty until it is asked for
};

} // namespace gr::wiforce::kernel
