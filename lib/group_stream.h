// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/counter.h"
#include "doppler_transform.h"
#include <gnuradio/wiforce/names.h>

#include <cstdint>
#include <memory>
#include <pmt/pmt.h>

namespace gr::wiforce {

// Bytes of a snapshot, or of a tone.
constexpr std::size_t FOLDED_BYTES = kernel::FFT_LENGTH * sizeof(kernel::fc32);
// Frames that are folded before they are weighted: their vectors stay in the first cache.
constexpr int BATCH = 32;

// Where a group_stream's tags and messages go: the block that owns it.
class group_outlet
{
public:
    virtual ~group_outlet() = default;
    virtual void
    tag_output(std::uint64_t offset, const pmt::pmt_t& key, std::uint64_t value) = 0;
    virtual void publish_incomplete(const pmt::pmt_t& pdu) = 0;
};

// Collects snapshots by their index on the frame grid into phase groups, and gives each
// group's transform with its tags, and the PDU of an incomplete one before it.
class group_stream
{
public:
    group_stream(std::unique_ptr<doppler_transform> transform,
                 int group_length,
                 group_outlet& outlet);

    int rows() const { return d_transform->rows(); }
    int item_length() const { return rows() * kernel::FFT_LENGTH; }
    std::uint64_t groups() const { return d_groups; }
    std::uint64_t incomplete_groups() const { return d_incomplete_groups; }

    // Slots from this snapshot to the end of its group.
    int room(std::uint64_t snapshot) const;
    // Whether the group at hand must be closed before this snapshot can be added.
    bool must_close_before(std::uint64_t snapshot) const;
    // Whether every slot of the group at hand is decided.
    bool is_full() const { return d_group.decided() == d_group.length(); }

    // Memory for up to room(snapshot) snapshots from this one on; accept() takes up as
    // many as were written.
    kernel::fc32* reserve(std::uint64_t snapshot);
    void accept(int count);

    // So many snapshots of the group at hand hold samples at full scale.
    void note_saturated(int snapshots) { d_saturated += snapshots; }

    // The receiver's settings were changed before the group at hand, or inside it.
    void mark_retuned() { d_retuned = true; }

    // Ends the group at hand and writes its item; returns whether there was one to write.
    bool close(kernel::fc32* out, std::uint64_t offset);

private:
    pmt::pmt_t incomplete_pdu() const;

    const std::unique_ptr<doppler_transform> d_transform;
    group_outlet& d_outlet;
    kernel::phase_group d_group;
    std::uint64_t d_index = 0;     // of the group at hand
    std::uint64_t d_saturated = 0; // snapshots of it
    bool d_retuned = false;
    kernel::counter d_groups;
    kernel::counter d_incomplete_groups;
};

// A block whose output is that of a group_stream; Base derives from gr::block.
template <class Base>
class group_block : public Base, private group_outlet
{
protected:
    template <class... Arguments>
    group_block(std::unique_ptr<doppler_transform> transform,
                int group_length,
                Arguments&&... arguments)
        : Base(std::forward<Arguments>(arguments)...),
          d_stream(std::move(transform), group_length, *this)
    {
        this->message_port_register_out(pmt::mp(names::INCOMPLETE));
    }

    // Ends the group at hand; returns the items written behind the `produced` first ones.
    int close_group(kernel::fc32* out, int produced)
    {
        return d_stream.close(out + static_cast<std::size_t>(produced) *
                                        d_stream.item_length(),
                              this->nitems_written(0) + produced);
    }

    group_stream d_stream;

private:
    void
    tag_output(std::uint64_t offset, const pmt::pmt_t& key, std::uint64_t value) override
    {
        this->add_item_tag(0, offset, key, pmt::from_uint64(value));
    }
    void publish_incomplete(const pmt::pmt_t& pdu) override
    {
        this->message_port_pub(pmt::mp(names::INCOMPLETE), pdu);
    }
};

} // namespace gr::wiforce
