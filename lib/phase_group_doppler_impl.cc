// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_block.h"
#include "kernel/doppler/doppler_transform.h"
#include "tag_values.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/phase_group_doppler.h>

#include <algorithm>

namespace gr::wiforce {

namespace {
constexpr int INPUT_BUFFER_SAMPLES = 256 * 64; // 128 kB

std::size_t vector_bytes(int symbol_length)
{
    return symbol_length * sizeof(kernel::fc32);
}
} // namespace

class phase_group_doppler_impl : public group_block<phase_group_doppler>
{
public:
    phase_group_doppler_impl(std::unique_ptr<kernel::doppler_transform> transform,
                             int group_length,
                             int symbol_length)
        : gr::block("phase_group_doppler",
                    gr::io_signature::make(1, 1, vector_bytes(symbol_length)),
                    gr::io_signature::make(
                        1, 1, transform->rows() * vector_bytes(symbol_length))),
          group_block(std::move(transform), group_length, symbol_length),
          d_symbol_length(symbol_length)
    {
        // By this rate the scheduler chooses the input buffer, as in preamble_fold: for
        // what a full buffer of samples folds to, and for no more than the cache holds.
        set_relative_rate(1, std::max(1, INPUT_BUFFER_SAMPLES / symbol_length / 2));
        set_tag_propagation_policy(TPP_DONT);
    }

    // Snapshots are collected as they come.
    void forecast(int, gr_vector_int& ninput_items_required) override
    {
        ninput_items_required[0] = 1;
    }

    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override
    {
        const auto* in = static_cast<const kernel::fc32*>(input_items[0]);
        auto* out = static_cast<kernel::fc32*>(output_items[0]);
        const int available = ninput_items[0];

        std::vector<gr::tag_t> tags;
        get_tags_in_window(tags, 0, 0, available, keys::snapshot);
        std::sort(tags.begin(), tags.end(), gr::tag_t::offset_compare);
        auto tag = tags.begin();

        int consumed = 0;
        int produced = 0;
        while (consumed < available && produced < noutput_items) {
            const std::uint64_t here = nitems_read(0) + consumed;
            for (; tag != tags.end() && tag->offset == here; ++tag)
                if (const auto index = snapshot_index(tag->value))
                    d_snapshot = *index;
                else
                    ignore(*tag);
            if (d_collector.must_end_before(d_snapshot)) {
                produced += end_group(out, produced);
                continue;
            }
            std::uint64_t untagged = available - consumed;
            if (tag != tags.end())
                untagged = std::min(untagged, tag->offset - here);
            const auto* snapshots =
                in + static_cast<std::size_t>(consumed) * d_symbol_length;
            d_collector.collect_in(out + produced * d_collector.size());
            const int count = d_collector.add(
                d_snapshot,
                untagged,
                [&](int n, kernel::fc32* slots, kernel::snapshot_noise* noise) {
                    std::copy_n(snapshots, n * d_symbol_length, slots);
                    write_noise(here, n, noise);
                    kernel::note_values_not_finite(slots, n, d_symbol_length, noise);
                    return n;
                });
            d_collector.note_saturated(tags_among(count, here, keys::saturated).size());
            if (!tags_among(count, here, keys::retuned).empty())
                mark_group_retuned();
            for (const gr::tag_t& tag : tags_among(count, here, keys::slipped))
                if (is_slip_value(tag.value))
                    mark_group_slipped(tag.value);
                else
                    ignore(tag);
            consumed += count;
            d_snapshot += count;
            if (d_collector.is_full())
                produced += end_group(out, produced);
        }
        consume_each(consumed);
        return produced;
    }

    bool start() override
    {
        // A flowgraph that is started again counts items anew, not so after unlock().
        if (nitems_read(0) == 0)
            d_noise = {};
        return phase_group_doppler::start();
    }

    int rows() const override { return d_collector.rows(); }
    std::uint64_t groups() const override { return d_groups; }
    std::uint64_t incomplete_groups() const override { return d_incomplete_groups; }

private:
    // A tag of ours that some other block has made, with a value of another type.
    void ignore(const gr::tag_t& tag)
    {
        if (!d_has_ignored)
            d_logger->warn("ignored a malformed value of the tag {}",
                           pmt::symbol_to_string(tag.key));
        d_has_ignored = true;
    }

    // Tags of so many input items.
    std::vector<gr::tag_t>
    tags_among(int count, std::uint64_t first, const pmt::pmt_t& key)
    {
        std::vector<gr::tag_t> tags;
        get_tags_in_range(tags, 0, first, first + count, key);
        return tags;
    }

    // The noise of so many input items, by the tags at them and the last one before;
    // zeros where no tag tells it.
    void write_noise(std::uint64_t first, int count, kernel::snapshot_noise* noise)
    {
        std::fill_n(noise, count, kernel::snapshot_noise{});
        std::vector<gr::tag_t> tags = tags_among(count, first, keys::noise);
        tags.insert(tags.begin(), d_noise);
        std::stable_sort(tags.begin(), tags.end(), gr::tag_t::offset_compare);
        for (const gr::tag_t& tag : tags) {
            if (!pmt::is_f32vector(tag.value)) {
                if (!pmt::is_null(tag.value)) // none has come yet
                    ignore(tag);
                continue;
            }
            const auto values = pmt::f32vector_elements(tag.value);
            const std::uint64_t end =
                std::min(tag.offset + values.size() / 2, first + count);
            for (auto item = std::max(first, tag.offset); item < end; item++) {
                const std::size_t at = 2 * (item - tag.offset);
                noise[item - first] = { values[at], values[at + 1] };
            }
            d_noise = tag;
        }
    }

    const int d_symbol_length;
    std::uint64_t d_snapshot = 0; // of the next input item
    gr::tag_t d_noise;            // the last one
    bool d_has_ignored = false;   // a malformed tag
};

phase_group_doppler::sptr phase_group_doppler::make(
    const std::vector<std::complex<double>>& weights, int group_length, int symbol_length)
{
    return gnuradio::make_block_sptr<phase_group_doppler_impl>(
        std::make_unique<kernel::tone_accumulator>(weights, group_length, symbol_length),
        group_length,
        symbol_length);
}

phase_group_doppler::sptr phase_group_doppler::spectrum(int group_length,
                                                        int symbol_length)
{
    return gnuradio::make_block_sptr<phase_group_doppler_impl>(
        std::make_unique<kernel::doppler_spectrum>(group_length),
        group_length,
        symbol_length);
}

phase_group_doppler::sptr phase_group_doppler::collected(int group_length,
                                                         int symbol_length)
{
    return gnuradio::make_block_sptr<phase_group_doppler_impl>(
        std::make_unique<kernel::collected_snapshots>(group_length),
        group_length,
        symbol_length);
}

} // namespace gr::wiforce
