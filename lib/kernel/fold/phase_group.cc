// SPDX-License-Identifier: GPL-3.0-or-later
#include "phase_group.h"

#include "../require.h"
#include "sample_loops.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace gr::wiforce::kernel {

void note_values_not_finite(const fc32* vectors,
                            int count,
                            int symbol_length,
                            snapshot_noise* noise)
{
    const auto* const values = reinterpret_cast<const float*>(vectors);
    const std::size_t width = 2 * symbol_length;
    for (int n = 0; n < count; n++)
        if (!are_finite(values + n * width, width))
            noise[n].largest = std::numeric_limits<float>::quiet_NaN();
}

phase_group::phase_group(int length, int symbol_length)
    : d_length(require_group_length(length)), d_symbol_length(symbol_length)
{
    require_symbol_length(symbol_length, "phase_group_doppler");
    d_snapshots.resize(offset_of(length));
    d_slots = d_snapshots.data();
    d_noise.resize(length);
    d_mask.resize(length);
}

void phase_group::clear()
{
    d_decided = 0;
    d_present = 0;
    d_rejected = 0;
}

void phase_group::write_to(fc32* slots)
{
    const fc32* const former = std::exchange(d_slots, slots ? slots : d_snapshots.data());
    if (former != d_slots)
        std::copy_n(former, offset_of(d_decided), d_slots);
}

fc32* phase_group::reserve(int first_slot)
{
    for (; d_decided < first_slot; d_decided++)
        d_mask[d_decided] = 0;
    return slot(first_slot);
}

void phase_group::accept(int count)
{
    for (const int end = d_decided + count; d_decided < end; d_decided++) {
        const bool finite = !std::isnan(d_noise[d_decided].largest);
        d_mask[d_decided] = finite;
        if (finite && d_present == 0)
            d_reference = d_decided;
        d_present += finite;
    }
}

void phase_group::finish()
{
    reserve(d_length);
    fill_absent();
}

void phase_group::reject(const std::vector<std::uint8_t>& rejected)
{
    for (int n = 0; n < d_length; n++)
        if (d_mask[n] && rejected[n]) {
            d_mask[n] = 0;
            d_present--;
            d_rejected++;
        }
    if (d_present > 0)
        d_reference = std::find(d_mask.begin(), d_mask.end(), 1) - d_mask.begin();
    fill_absent();
}

void phase_group::fill_absent()
{
    for (int n = 0; n < d_length && d_present + d_rejected > 0; n++)
        if (!d_mask[n] && n != d_reference)
            std::copy_n(reference(), d_symbol_length, slot(n));
}

void phase_group::copy_to(fc32* out) const
{
    for (int n = 0; n < d_length; n++, out += d_symbol_length)
        if (!d_mask[n])
            std::fill_n(out, d_symbol_length, fc32());
        else if (out != slot(n))
            std::copy_n(slot(n), d_symbol_length, out);
}

void phase_group::copy_present_to(fc32* out) const
{
    for (int n = 0; n < d_length; n++)
        if (d_mask[n])
            out = std::copy_n(slot(n), d_symbol_length, out);
}

std::vector<fc32> phase_group::mean() const
{
    std::vector<std::complex<double>> sums(d_symbol_length);
    for (int n = 0; n < d_length; n++)
        for (int k = 0; d_mask[n] && k < d_symbol_length; k++)
            sums[k] += slot(n)[k];
    std::vector<fc32> result(d_symbol_length);
    for (int k = 0; k < d_symbol_length; k++)
        result[k] = fc32(sums[k] / double(std::max(d_present, 1)));
    return result;
}

} // namespace gr::wiforce::kernel
