// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "doppler_transform.h"
#include "interference_screen.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>

namespace gr::wiforce::kernel {

/*
 * Collects snapshots by their index on the frame grid into phase groups, one at a time,
 * and transforms each. Group g holds the snapshots g N_g .. (g + 1) N_g - 1.
 *
 * In turns: add() while the next snapshot belongs to the group, and when it is full or
 * the next one does not belong to it, end() and, after the results are taken, clear().
 */
class group_collector
{
public:
    // Frames to fold at a time: their largest sample says whether all are finite, and
    // only where they may not be is each vector looked through, still in the first cache.
    static constexpr int BATCH = 32;

    // Collectors of the same recording share a screen, which learns from its groups in
    // order.
    group_collector(std::unique_ptr<doppler_transform> transform,
                    int group_length,
                    int symbol_length,
                    std::shared_ptr<interference_screen> screen)
        : d_transform(std::move(transform)),
          d_group(group_length, symbol_length),
          d_screen(std::move(screen))
    {
    }

    int rows() const { return d_transform->rows(); }
    // Values of a transformed group.
    std::size_t size() const { return std::size_t(rows()) * d_group.symbol_length(); }
    bool passes_snapshots() const { return d_transform->passes_snapshots(); }

    // Whether the group must end before this snapshot can be added.
    bool must_end_before(std::uint64_t snapshot) const
    {
        const std::uint64_t length = d_group.length();
        return d_group.decided() > 0 &&
               (snapshot / length != d_index ||
                snapshot % length < static_cast<std::uint64_t>(d_group.decided()));
    }
    // Whether every slot of the group is known to be present or missing.
    bool is_full() const { return d_group.decided() == d_group.length(); }

    // Where snapshots are passed on, collects them in the memory that they are wanted in,
    // size() values, or in its own.
    void collect_in(fc32* out)
    {
        if (passes_snapshots())
            d_group.write_to(out);
    }

    // Adds some of `available` snapshots from this index on, which
    // write(count, folded, noise) writes at most, values that are not finite noted
    // (phase_group::accept); it and this return how many.
    template <class Write>
    int add(std::uint64_t snapshot, std::uint64_t available, const Write& write)
    {
        d_index = snapshot / d_group.length();
        const int slot = snapshot % d_group.length();
        const int most = std::min<std::uint64_t>(available, d_group.length() - slot);
        fc32* const folded = d_group.reserve(slot);
        const int count = write(most, folded, d_group.noise());
        d_group.accept(count);
        return count;
    }
    void note_saturated(int snapshots) { d_saturated += snapshots; }

    // Ends the group, and rejects the snapshots that interference hit, or marks them
    // where snapshots are passed on; returns whether it has any, rejected ones included.
    bool end()
    {
        d_group.finish();
        if (d_transform->rejects_interference() || d_transform->passes_snapshots()) {
            const auto& marks = d_screen->examine(d_group);
            if (d_transform->rejects_interference() && d_screen->rejected() > 0)
                d_group.reject(marks);
        }
        return d_group.present() + d_group.rejected() > 0;
    }
    // Of the group that ended:
    std::uint64_t index() const { return d_index; }
    const phase_group& group() const { return d_group; }
    int saturated() const { return d_saturated; } // snapshots
    // Snapshots that interference hit, 1 each.
    const std::vector<std::uint8_t>& marks() const { return d_screen->marks(); }
    int marked() const { return d_screen->rejected(); }
    void transform(fc32* out) { d_transform->transform(d_group, out); }

    void clear()
    {
        d_group.clear();
        d_saturated = 0;
    }

private:
    const std::unique_ptr<doppler_transform> d_transform;
    phase_group d_group;
    const std::shared_ptr<interference_screen> d_screen;
    std::uint64_t d_index = 0;
    int d_saturated = 0;
};

} // namespace gr::wiforce::kernel
