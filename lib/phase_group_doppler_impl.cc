// SPDX-License-Identifier: GPL-3.0-or-later
#include "phase_group_doppler_impl.h"

#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/names.h>

#include <algorithm>

namespace gr::wiforce {

namespace {
const pmt::pmt_t incomplete_port = pmt::mp(names::INCOMPLETE);
const pmt::pmt_t snapshot_key = pmt::mp(names::SNAPSHOT);
const pmt::pmt_t group_key = pmt::mp(names::GROUP);
const pmt::pmt_t missing_key = pmt::mp(names::MISSING);
const pmt::pmt_t mask_key = pmt::mp(names::MASK);
} // namespace

phase_group_doppler::sptr
phase_group_doppler::make(const std::vector<std::complex<double>>& weights,
                          int group_length)
{
    return gnuradio::make_block_sptr<phase_group_doppler_impl>(
        std::make_unique<doppler_tones>(weights, group_length), group_length);
}

phase_group_doppler::sptr phase_group_doppler::spectrum(int group_length)
{
    kernel::phase_group check(group_length);
    return gnuradio::make_block_sptr<phase_group_doppler_impl>(
        std::make_unique<doppler_spectrum>(group_length), group_length);
}

phase_group_doppler_impl::phase_group_doppler_impl(
    std::unique_ptr<doppler_transform> transform, int group_length)
    : gr::block("phase_group_doppler",
                gr::io_signature::make(1, 1, kernel::FFT_LENGTH * sizeof(kernel::fc32)),
                gr::io_signature::make(
                    1, 1, transform->rows() * kernel::FFT_LENGTH * sizeof(kernel::fc32))),
      d_transform(std::move(transform)),
      d_group(group_length)
{
    set_relative_rate(1, group_length);
    set_tag_propagation_policy(TPP_DONT);
    message_port_register_out(incomplete_port);
}

// Snapshots are taken up as they come: the last of a group finds its work nearly done.
void phase_group_doppler_impl::forecast(int, gr_vector_int& ninput_items_required)
{
    ninput_items_required[0] = 1;
}

void phase_group_doppler_impl::publish_incomplete() const
{
    const int length = d_group.length();
    std::vector<kernel::fc32> snapshots(std::size_t(length) * kernel::FFT_LENGTH);
    d_group.copy_with_zeros(snapshots.data());
    pmt::pmt_t about = pmt::make_dict();
    about = pmt::dict_add(about, group_key, pmt::from_uint64(d_index));
    about = pmt::dict_add(about, mask_key, pmt::init_u8vector(length, d_group.mask()));
    const_cast<phase_group_doppler_impl*>(this)->message_port_pub(
        incomplete_port,
        pmt::cons(about, pmt::init_c32vector(snapshots.size(), snapshots)));
}

bool phase_group_doppler_impl::close_group(kernel::fc32* out, int produced)
{
    d_group.finish();
    const bool emitted = d_group.present() > 0;
    if (emitted) {
        const std::uint64_t offset = nitems_written(0) + produced;
        if (d_group.missing() > 0) {
            publish_incomplete();
            add_item_tag(0, offset, missing_key, pmt::from_uint64(d_group.missing()));
            d_incomplete_groups++;
        }
        add_item_tag(0, offset, group_key, pmt::from_uint64(d_index));
        d_transform->finish(d_group, out);
        d_groups++;
    }
    d_group.clear();
    d_transform->clear();
    return emitted;
}

bool phase_group_doppler_impl::starts_new_group(std::uint64_t snapshot) const
{
    const std::uint64_t length = d_group.length();
    return d_group.decided() > 0 &&
           (snapshot / length != d_index ||
            snapshot % length < std::uint64_t(d_group.decided()));
}

int phase_group_doppler_impl::general_work(int noutput_items,
                                           gr_vector_int& ninput_items,
                                           gr_vector_const_void_star& input_items,
                                           gr_vector_void_star& output_items)
{
    const auto* in = static_cast<const kernel::fc32*>(input_items[0]);
    auto* out = static_cast<kernel::fc32*>(output_items[0]);
    const std::size_t out_length = std::size_t(rows()) * kernel::FFT_LENGTH;
    const int available = ninput_items[0];
    const int length = d_group.length();

    std::vector<gr::tag_t> tags;
    get_tags_in_window(tags, 0, 0, available, snapshot_key);
    std::sort(tags.begin(), tags.end(), gr::tag_t::offset_compare);
    auto tag = tags.begin();

    int consumed = 0;
    int produced = 0;
    while (consumed < available && produced < noutput_items) {
        const auto here = [&] { return nitems_read(0) + consumed; };
        std::uint64_t snapshot = d_snapshot;
        for (; tag != tags.end() && tag->offset == here(); ++tag)
            snapshot = pmt::to_uint64(tag->value);
        if (starts_new_group(snapshot)) {
            produced += close_group(out + produced * out_length, produced);
            d_snapshot = snapshot;
            if (produced == noutput_items)
                break;
        }
        d_index = snapshot / length;
        const int slot = snapshot % length;
        int count = std::min(available - consumed, length - slot);
        if (tag != tags.end())
            count = std::min<std::uint64_t>(count, tag->offset - here());
        d_group.add(slot, in + std::size_t(consumed) * kernel::FFT_LENGTH, count);
        d_transform->advance(d_group);
        consumed += count;
        d_snapshot = snapshot + count;
        if (slot + count == length)
            produced += close_group(out + produced * out_length, produced);
    }
    consume_each(consumed);
    return produced;
}

} // namespace gr::wiforce
