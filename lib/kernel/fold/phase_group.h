// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

// Makes the largest noise NaN of vectors with a value that is not finite.
void note_values_not_finite(const fc32* vectors,
                            int count,
                            int symbol_length,
                            snapshot_noise* noise);

/*
 * The snapshots of one phase group, slot by slot, and which of them are there.
 *
 * A snapshot that was lost, or whose noise is NaN since it holds a value which is not
 * finite, is missing. One that was received and is not to be used is rejected. Both are
 * absent. In the end absent slots hold the group's first present snapshot, the reference:
 * sums of differences from it (see tone_accumulator) then need not check the mask.
 */
class phase_group
{
public:
    // Throws std::invalid_argument unless length >= 1 and a snapshot has 16 to 4096
    // samples.
    explicit phase_group(int length, int symbol_length = DEFAULT_SYMBOL_LENGTH);
    phase_group(const phase_group&) = delete; // slots may be its own

    void clear();

    // Keeps the slots in other memory from now on, symbol_length * length values, which
    // those of the group at hand are copied to; in its own where none is given.
    void write_to(fc32* slots = nullptr);

    // Memory for the snapshots from first_slot on, and for their noise behind noise();
    // slots left out since the last call are missing. first_slot >= decided(). accept()
    // takes up as many as were written, and trusts their noise: who writes snapshots that
    // may hold values which are not finite calls note_values_not_finite().
    fc32* reserve(int first_slot);
    snapshot_noise* noise() { return &d_noise[d_decided]; }
    void accept(int count);

    // Declares the remaining slots missing.
    void finish();
    // Makes the present snapshots that are marked absent; `rejected` holds length()
    // marks.
    void reject(const std::vector<std::uint8_t>& rejected);

    int length() const { return d_length; }
    int symbol_length() const { return d_symbol_length; } // samples of a snapshot
    // Slots that are known to be present or absent.
    int decided() const { return d_decided; }
    int present() const { return d_present; }
    int rejected() const { return d_rejected; }
    int missing() const { return d_decided - d_present - d_rejected; }
    bool is_complete() const { return d_present == d_decided; }
    const std::vector<std::uint8_t>& mask() const { return d_mask; } // 1 = present

    // Valid once present() + rejected() > 0.
    const fc32* reference() const { return slot(d_reference); }
    const fc32* slot(int n) const { return d_slots + offset_of(n); }
    const snapshot_noise& noise_of(int n) const { return d_noise[n]; }

    // All slots, absent ones as zeros: symbol_length * length values. `out` may be the
    // memory of the slots.
    void copy_to(fc32* out) const;
    // The present ones only: symbol_length * present() values.
    void copy_present_to(fc32* out) const;
    // Mean of the present ones, zeros without any.
    std::vector<fc32> mean() const;

private:
    void fill_absent();
    fc32* slot(int n) { return d_slots + offset_of(n); }
    std::size_t offset_of(int n) const
    {
        return static_cast<std::size_t>(n) * d_symbol_length;
    }

    const int d_length;
    const int d_symbol_length;
    std::vector<fc32> d_snapshots;
    fc32* d_slots; // those, or memory that was given
    std::vector<snapshot_noise> d_noise;
    std::vector<std::uint8_t> d_mask;
    int d_decided = 0;
    int d_present = 0;
    int d_rejected = 0;
    int d_reference = 0;
};

} // namespace gr::wiforce::kernel
