// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "doppler_transform.h"

namespace gr::wiforce::kernel {

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

} // namespace gr::wiforce::kernel
