// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_stream.h"

#include <gnuradio/wiforce/names.h>

namespace gr::wiforce {

namespace {
const pmt::pmt_t group_key = pmt::mp(names::GROUP);
const pmt::pmt_t missing_key = pmt::mp(names::MISSING);
const pmt::pmt_t saturated_key = pmt::mp(names::SATURATED);
const pmt::pmt_t retuned_key = pmt::mp(names::RETUNED);
const pmt::pmt_t mask_key = pmt::mp(names::MASK);
} // namespace

group_stream::group_stream(std::unique_ptr<doppler_transform> transform,
                           int group_length,
                           group_outlet& outlet)
    : d_transform(std::move(transform)), d_outlet(outlet), d_group(group_length)
{
}

int group_stream::room(std::uint64_t snapshot) const
{
    return d_group.length() - static_cast<int>(snapshot % d_group.length());
}

bool group_stream::must_close_before(std::uint64_t snapshot) const
{
    const std::uint64_t length = d_group.length();
    return d_group.decided() > 0 &&
           (snapshot / length != d_index ||
            snapshot % length < static_cast<std::uint64_t>(d_group.decided()));
}

kernel::fc32* group_stream::reserve(std::uint64_t snapshot)
{
    d_index = snapshot / d_group.length();
    return d_group.reserve(snapshot % d_group.length());
}

void group_stream::accept(int count)
{
    d_group.accept(count);
    d_transform->advance(d_group);
}

pmt::pmt_t group_stream::incomplete_pdu() const
{
    std::vector<kernel::fc32> snapshots(static_cast<std::size_t>(d_group.length()) *
                                        kernel::FFT_LENGTH);
    d_group.copy_with_zeros(snapshots.data());
    pmt::pmt_t about = pmt::make_dict();
    about = pmt::dict_add(about, group_key, pmt::from_uint64(d_index));
    about = pmt::dict_add(
        about, mask_key, pmt::init_u8vector(d_group.length(), d_group.mask()));
    return pmt::cons(about, pmt::init_c32vector(snapshots.size(), snapshots));
}

bool group_stream::close(kernel::fc32* out, std::uint64_t offset)
{
    d_group.finish();
    const bool emitted = d_group.present() > 0;
    if (emitted) {
        if (d_group.missing() > 0) {
            d_outlet.publish_incomplete(incomplete_pdu());
            d_outlet.tag_output(offset, missing_key, d_group.missing());
            d_incomplete_groups += 1;
        }
        if (d_saturated > 0)
            d_outlet.tag_output(offset, saturated_key, d_saturated);
        if (d_retuned)
            d_outlet.tag_output(offset, retuned_key, 1);
        d_retuned = false;
        d_outlet.tag_output(offset, group_key, d_index);
        d_transform->finish(d_group, out);
        d_groups += 1;
    }
    d_group.clear();
    d_saturated = 0;
    d_transform->clear();
    return emitted;
}

} // namespace gr::wiforce
