// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The snapshots of one phase group, slot by slot, and which of them are there.
 *
 * A snapshot that was lost, or that holds a value which is not finite, is absent. Absent
 * slots hold the group's first present snapshot, the reference: sums of differences from
 * it (see tone_accumulator) then need not check the mask.
 */
class phase_group
{
public:
    // Throws std::invalid_argument unless length >= 1.
    explicit phase_group(int length);

    void clear();

    // Memory for the snapshots from first_slot on; slots left out since the last call are
    // absent. first_slot >= decided(). accept() takes up as many as were written.
    fc32* reserve(int first_slot);
    void accept(int count);

    // Declares the remaining slots absent.
    void finish();

    int length() const { return d_length; }
    // Slots that are known to be present or absent.
    int decided() const { return d_decided; }
    int present() const { return d_present; }
    int missing() const { return d_decided - d_present; }
    const std::vector<std::uint8_t>& mask() const { return d_mask; } // 1 = present

    // Valid once present() > 0.
    const fc32* reference() const { return slot(d_reference); }
    const fc32* slot(int n) const { return d_snapshots.data() + n * FFT_LENGTH; }

    // All slots, absent ones as zeros: 64 * length values.
    std::vector<fc32> with_zeros() const;
    // The present ones only.
    std::vector<fc32> present_snapshots() const;

private:
    void skip_to(int slot);
    fc32* slot(int n) { return d_snapshots.data() + n * FFT_LENGTH; }

    const int d_length;
    std::vector<fc32> d_snapshots;
    std::vector<std::uint8_t> d_mask;
    int d_decided = 0;
    int d_present = 0;
    int d_reference = 0;
};

} // namespace gr::wiforce::kernel
