// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "doppler_transform.h"

#include <vector>

namespace gr::wiforce::kernel {

/*
 * Weighted sums over the snapshots of a phase group, one per row ("tone") of a weight
 * table:
 *
 *   P[m, k] = sum_n w[m, n] h[n, k],  over the snapshots n that are there,
 *
 * computed as sum_n w[m, n] (h[n, k] - h0[k]) + (sum_n w[m, n]) h0[k], h0 the group's
 * first snapshot. This is exact for any table. The second sum of weights is taken in
 * double, so a static path leaves the tones by the table's own zero and not by the
 * rounding of float.
 *
 * h is multiplied by real weights: Re w and Im w of a complex row. Rows that are complex
 * conjugates of each other (tones +m and -m) share these sums, and a real row needs one.
 */
class tone_accumulator : public doppler_transform
{
public:
    // weights: rows x group_length, row by row. Throws std::invalid_argument unless
    // group_length >= 1 and the table is finite and holds at least one whole row.
    tone_accumulator(const std::vector<std::complex<double>>& weights,
                     int group_length,
                     int symbol_length = DEFAULT_SYMBOL_LENGTH);

    int rows() const override { return static_cast<int>(d_tones.size()); }
    int real_rows() const { return d_real_rows; } // sums taken over the snapshots

    void transform(const phase_group& group, fc32* tones) override;
    // Of a complete group whose snapshots follow each other at `snapshots`.
    void transform(const fc32* snapshots, fc32* tones)
    {
        transform(snapshots, snapshots, {}, tones);
    }

private:
    // Snapshots at a time: 16 kB of the default symbol, which stay in the first cache.
    static constexpr int BLOCK = 32;

    // P = sums[real] + j sign sums[imaginary]; a real row has imaginary < 0.
    struct tone {
        int real;
        int imaginary;
        float sign;
    };

    void lay_out_rows();
    // `reference` is in the place of the absent snapshots.
    void transform(const fc32* snapshots,
                   const fc32* reference,
                   const std::vector<int>& absent,
                   fc32* tones);

    const int d_length;
    const int d_width; // floats of a snapshot
    const std::vector<std::complex<double>> d_table;
    std::vector<tone> d_tones;
    std::vector<std::complex<double>> d_weight_sums; // of whole groups
    int d_real_rows = 0;
    int d_padded_rows = 0;
    std::vector<float> d_weights; // group_length x padded rows
    std::vector<float> d_sums;    // padded rows x width
};

} // namespace gr::wiforce::kernel
