// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../doppler/switching_mixer.h"
#include "../types.h"

#include <cstddef>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

// The M tones of a group lie at opposite frequencies, and their weights are conjugates:
// each pair is a + jb and a - jb. These parts a and b (M x K, pair by pair from the
// lowest frequency) have real weights, hence noise of a real covariance and a real
// response to the tags' waveforms, which costs half to a quarter of the arithmetic.
template <class T> // float or double
void parts_of(const std::complex<T>* tones,
              std::size_t count,
              std::size_t subcarriers,
              complex* parts);

// The pair that one of the M tones belongs to, and the sign of its second part.
inline std::pair<std::size_t, int> pair_of(std::size_t row, std::size_t count)
{
    return row >= count / 2 ? std::pair{ row - count / 2, 1 }
                            : std::pair{ count / 2 - 1 - row, -1 };
}

// One of the M tones, row of K, from the parts.
void tone_of(const complex* parts,
             std::size_t row,
             std::size_t count,
             std::size_t subcarriers,
             complex* tone);

// Makes the noise of parts (M x K) white by a lower triangular matrix (M x M); gives the
// mean power of the result.
double whiten(const double* whitener,
              const complex* parts,
              std::size_t count,
              std::size_t subcarriers,
              complex* white);

// Weights that lead from the snapshots received of a group to its M tones.
class group_weights
{
public:
    // `mixed`: of whitened parts, a row for each snapshot; `times_s`: of the snapshots,
    // from the centre. `whitener`: lower triangular, M x M, makes the noise of parts
    // white. `loss`: snapshots of a group over those received.
    group_weights(const std::vector<double>& mixed,
                  const std::vector<double>& times_s,
                  std::vector<double> whitener,
                  double loss)
        : mixer(mixed, times_s), loss(loss), d_whitener(std::move(whitener))
    {
    }

    const switching_mixer mixer;
    const double loss;

    std::size_t tones() const { return mixer.columns(); }

    const std::vector<double>& whitener() const { return d_whitener; }

    // Inverse of the whitener.
    const std::vector<double>& colorer() const;

private:
    const std::vector<double> d_whitener;
    mutable std::vector<double> d_colorer; // empty until it is asked for
};

} // namespace gr::wiforce::kernel
