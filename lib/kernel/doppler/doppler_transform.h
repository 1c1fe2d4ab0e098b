// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/phase_group.h"
#include "../fourier/fourier_transform.h"

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

} // namespace gr::wiforce::kernel
