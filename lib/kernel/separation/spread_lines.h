// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fourier/fourier_transform.h"
#include "end_fit.h"
#include "group_weights.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Removes what tags spread over the subcarriers from the tones of groups; for one thread.
//
// A switch that closes within a symbol passes only a part of its samples: each of the
// tag's lines then spreads over the subcarriers (intercarrier interference). With the
// symbol y_i as received from end i, whose transform is X V_i, and the response M_i[n] of
// the tones to its sample n, the tones are the transform of sum_i M_i[n] y_i[n], rotated
// as they were, over X. The fit has the mean of M_i; the rest is computed from its ends.
class spread_lines
{
public:
    struct settings {
        std::vector<int> bins;         // K, of the N of a symbol
        std::vector<complex> spectrum; // N, of the symbol that is sent
        std::vector<complex> factors;  // K, from the transform to the channel
        int repetitions;               // of the symbol, that a snapshot is the mean of
        // Factors (M/2 x N) that rotated the samples of the tones of positive frequency,
        // times what this leaves of their mean over the symbol otherwise; empty if none
        // did.
        std::vector<complex> rotation;
        int rounds; // times that the ends are solved
    };

    // Throws std::invalid_argument where the sizes do not agree.
    explicit spread_lines(settings of);

    std::size_t tones() const // 0: any
    {
        return 2 * d_of.rotation.size() / d_of.spectrum.size();
    }
    std::size_t subcarriers() const { return d_of.bins.size(); }

    // Removes them from the parts (M x K) of group `row` of a fit of these tags at these
    // clocks. `switched`: their waveforms in the parts (`group_weights::switched`).
    void remove(const end_fit& fit,
                std::size_t row,
                const group_weights& weights,
                const switching_clock* clocks,
                const switching_pulses* pulses,
                const double* switched,
                complex* parts);

private:
    std::vector<complex> received(const complex* ends, std::size_t count);
    std::vector<double> passed(const complex* symbols,
                               std::size_t ends,
                               const group_weights& weights,
                               const switching_clock* clocks,
                               const switching_pulses* pulses,
                               const double* switched) const;
    void subtract(const std::vector<double>& samples,
                  const group_weights& weights,
                  complex* parts);

    const settings d_of;
    // Where the channel of each bin comes from: those below and above it among the used
    // ones, and the weight of the latter.
    struct source {
        std::size_t below, above;
        double upper_share;
    };
    std::vector<source> d_sources;
    fourier_transform d_fourier;
};

} // namespace gr::wiforce::kernel
