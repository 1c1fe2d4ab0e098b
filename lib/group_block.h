// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/doppler/group_collector.h"
#include "tag_values.h"
#include <gnuradio/wiforce/names.h>

#include <cstdint>
#include <memory>
#include <pmt/pmt.h>

namespace gr::wiforce {

// A block whose output items are the transforms of phase groups, with the tags of each
// and the PDU of an incomplete one before it. Base derives from gr::block.
template <class Base>
class group_block : public Base
{
protected:
    template <class... Arguments>
    group_block(std::unique_ptr<kernel::doppler_transform> transform,
                int group_length,
                int symbol_length,
                Arguments&&... arguments)
        : Base(std::forward<Arguments>(arguments)...),
          d_collector(
              std::move(transform),
              group_length,
              symbol_length,
              std::make_shared<kernel::interference_screen>(group_length, symbol_length))
    {
        if (!d_collector.passes_snapshots())
            this->message_port_register_out(d_incomplete_port);
    }

    // The output's memory may be another one after it.
    bool stop() override
    {
        d_collector.collect_in(nullptr);
        return Base::stop();
    }

    // The receiver's settings changed before the group at hand, or inside it.
    void mark_group_retuned() { d_retuned = true; }

    // Frame timing slipped before the group at hand, or inside it: frames before it may
    // lie elsewhere. Takes the value of a tag.
    void mark_group_slipped(const pmt::pmt_t& misplaced)
    {
        for (const std::uint64_t frame : pmt::u64vector_elements(misplaced))
            d_misplaced.push_back(frame);
    }

    // Ends the group at hand; returns the items written after the `produced` first ones.
    int end_group(kernel::fc32* out, int produced)
    {
        const bool emitted = d_collector.end();
        if (emitted) {
            const int missing = d_collector.group().missing();
            const int rejected = d_collector.group().rejected();
            const bool incomplete = missing + rejected > 0;
            d_incomplete_groups += incomplete;
            if (d_collector.passes_snapshots())
                tag_snapshots(produced);
            else {
                if (incomplete)
                    this->message_port_pub(d_incomplete_port, incomplete_pdu());
                const auto mean = d_collector.group().mean();
                tag(produced, names::STATIC, pmt::init_c32vector(mean.size(), mean));
            }
            tag_count(produced, names::MISSING, missing);
            tag_count(produced, names::REJECTED, rejected);
            tag_count(produced, names::SATURATED, d_collector.saturated());
            tag_count(produced, names::RETUNED, d_retuned);
            d_retuned = false;
            if (!d_misplaced.empty())
                tag(produced,
                    names::SLIPPED,
                    pmt::init_u64vector(d_misplaced.size(), d_misplaced));
            d_misplaced.clear();
            tag(produced, names::GROUP, pmt::from_uint64(d_collector.index()));
            d_collector.transform(out + produced * d_collector.size());
            d_groups += 1;
        }
        d_collector.clear();
        return emitted;
    }

    kernel::group_collector d_collector;
    kernel::counter d_groups;
    kernel::counter d_incomplete_groups;

private:
    void tag(int item, const char* key, const pmt::pmt_t& value)
    {
        this->add_item_tag(0, this->nitems_written(0) + item, pmt::mp(key), value);
    }
    void tag_count(int item, const char* key, std::uint64_t count)
    {
        if (count > 0)
            tag(item, key, pmt::from_uint64(count));
    }

    // Which of the snapshots that the item consists of were received, and which of them
    // interference hit.
    void tag_snapshots(int item)
    {
        const kernel::phase_group& group = d_collector.group();
        if (!group.is_complete())
            tag(item, names::MASK, pmt::init_u8vector(group.length(), group.mask()));
        if (d_collector.marked() > 0)
            tag(item,
                names::DISTURBED,
                pmt::init_u8vector(group.length(), d_collector.marks()));
    }

    pmt::pmt_t incomplete_pdu() const
    {
        const kernel::phase_group& group = d_collector.group();
        std::vector<kernel::fc32> snapshots(group.length() * group.symbol_length());
        group.copy_to(snapshots.data());
        pmt::pmt_t meta = pmt::make_dict();
        meta = pmt::dict_add(
            meta, pmt::mp(names::GROUP), pmt::from_uint64(d_collector.index()));
        meta = pmt::dict_add(
            meta, pmt::mp(names::MASK), pmt::init_u8vector(group.length(), group.mask()));
        return pmt::cons(meta, pmt::init_c32vector(snapshots.size(), snapshots));
    }

    const pmt::pmt_t d_incomplete_port = pmt::mp(names::INCOMPLETE);
    bool d_retuned = false;
    std::vector<std::uint64_t> d_misplaced; // first and end of a range, for each slip
};

} // namespace gr::wiforce
