// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/phase_group.h"
#include "../fourier/fourier_transform.h"

#include <vector>

namespace gr::wiforce::kernel {

// A linear transform over the snapshots of a phase group: rows() x samples of a snapshot.
class doppler_transform
{
public:
    virtual ~doppler_transform() = default;
    virtual int rows() const = 0;
    // Whether snapshots that interference hit are to be rejected. Not where nobody solves
    // the group for the rest: their absence lets static paths leak.
    virtual bool rejects_interference() const { return true; }
    // Whether the rows are the group's snapshots, for receivers that transform them and
    // know which ones interference hit.
    virtual bool passes_snapshots() const { return false; }
    // Of a finished group with at least one snapshot.
    virtual void transform(const phase_group& group, fc32* out) = 0;
};

// The snapshots of a phase group as they are, absent ones as zeros and those that
// interference hit unchanged: N_g rows. For receivers that survey the room in them.
class collected_snapshots : public doppler_transform
{
public:
    // group_length >= 1 is checked by the phase_group.
    explicit collected_snapshots(int group_length) : d_length(group_length) {}
    int rows() const override { return d_length; }
    bool rejects_interference() const override { return false; }
    bool passes_snapshots() const override { return true; }
    void transform(const phase_group& group, fc32* out) override { group.copy_to(out); }

private:
    const int d_length;
};

// The whole Doppler spectrum of a phase group, scaled by 1/N_g: N_g rows in natural FFT
// order.
class doppler_spectrum : public doppler_transform
{
public:
    // Throws std::invalid_argument unless group_length >= 1.
    explicit doppler_spectrum(int group_length);
    int rows() const override { return d_fft.length(); }
    bool rejects_interference() const override { return false; }
    void transform(const phase_group& group, fc32* out) override;

private:
    fourier_transform d_fft;
};

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
    tone_accumulator(const std::vector<complex>& weights,
                     int group_length,
                     int symbol_length = DEFAULT_SYMBOL_LENGTH);

    int rows() const override { return static_cast<int>(d_tones.size()); }

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

    // `reference` is in the place of the absent snapshots.
    void transform(const fc32* snapshots,
                   const fc32* reference,
                   const std::vector<int>& absent,
                   fc32* tones);

    const int d_length;
    const int d_width; // floats of a snapshot
    const std::vector<complex> d_table;
    std::vector<tone> d_tones;
    std::vector<complex> d_weight_sums; // of whole groups
    int d_padded_rows = 0;
    std::vector<float> d_weights; // group_length x padded rows
    std::vector<float> d_sums;    // padded rows x width
};

} // namespace gr::wiforce::kernel
