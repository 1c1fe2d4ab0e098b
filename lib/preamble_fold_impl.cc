// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_block.h"
#include "input_events.h"
#include "kernel/doppler/doppler_transform.h"
#include "kernel/fold/frame_walk.h"
#include "kernel/require.h"
#include "tag_values.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/preamble_fold.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace gr::wiforce {

namespace {

constexpr int INPUT_BUFFER_SAMPLES = 1 << 19;

std::size_t vector_bytes(const kernel::preamble_folder& folder)
{
    return folder.symbol_length() * sizeof(kernel::fc32);
}

} // namespace

// Walks over the frames between the gaps that rx_time reports or the frames' place shows.
// Derived classes process the frames. Sample is kernel::fc32 or kernel::sc16.
template <class Sample>
class preamble_fold_impl : public preamble_fold
{
public:
    preamble_fold_impl(const kernel::preamble_folder& folder,
                       double sample_rate,
                       std::uint64_t frame_offset)
        : d_folder(folder),
          d_events(sample_rate, this->d_logger),
          d_walk(folder, frame_offset),
          d_mean(folder.frame_length(), frame_offset)
    {
        // The scheduler gives the block before this one a buffer of twice what
        // relative_rate says is needed for one output. With its default of 8192 samples
        // it would spend its time switching threads; more than this is no faster.
        // Nothing else looks at the rate, since tags are not propagated, and small
        // packets are still taken as they come.
        set_relative_rate(1, INPUT_BUFFER_SAMPLES / 2);
        set_tag_propagation_policy(TPP_DONT);
    }

    bool start() override
    {
        // What was read and not taken up before a stop is lost, and its tags with it.
        // After unlock() the items are counted on.
        if (this->nitems_read(0) == 0) {
            d_tags_read_to = d_items_read;
            d_events.forget();
        }
        return preamble_fold::start();
    }

    // One window is enough to work on; whatever else has arrived is taken along.
    void forecast(int, gr_vector_int& ninput_items_required) override
    {
        ninput_items_required[0] = d_folder.averaged_length();
    }

    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override
    {
        const auto* in = static_cast<const Sample*>(input_items[0]);
        d_out = static_cast<kernel::fc32*>(output_items[0]);
        d_room = noutput_items;
        d_produced = 0;
        const std::uint64_t available = ninput_items[0];
        const std::uint64_t first = d_items_read;
        collect_tags(ninput_items[0]);

        std::uint64_t consumed = 0;
        while (true) {
            // What a decision finds changes the meaning of the tags behind it.
            std::uint64_t end = available;
            if (d_usable)
                end = std::min(end - consumed, d_walk.until_decision()) + consumed;
            const auto& event = d_events.next(first + end);
            // One that waits for room in the output may lie behind a decision.
            const bool ends_here = event && event->item < first + end;
            if (ends_here)
                end = event->item - first;
            if (d_usable && !take_whole_frames(in, consumed, end))
                break;
            if (ends_here || !d_usable) {
                skip(end - consumed);
                consumed = end;
            }
            if (ends_here) {
                take_event(*event);
                d_events.drop();
            } else if (d_usable && d_walk.decision_is_due()) {
                follow_frames();
            } else {
                break;
            }
        }
        this->consume_each(consumed);
        d_items_read += consumed;
        return d_produced;
    }

    std::uint64_t snapshots() const override { return d_snapshots; }
    std::uint64_t samples_lost() const override { return d_samples_lost; }
    std::uint64_t gaps() const override { return d_gaps; }
    void expect_carrier(double frequency_hz) override
    {
        d_events.expect_carrier(frequency_hz);
    }

    double refused_rate() const override { return d_events.settings().refused_rate(); }
    double refused_carrier() const override
    {
        return d_events.settings().refused_carrier();
    }
    std::uint64_t times_ignored() const override { return d_events.times_ignored(); }
    std::uint64_t frames_moved() const override { return d_frames_moved; }
    std::uint64_t samples_moved() const override { return d_samples_moved; }
    std::vector<std::complex<double>> mean_frame() const override
    {
        return d_mean.mean();
    }

protected:
    // Folds some of the whole frames, the first one's averaged samples at `averaged`, its
    // index `snapshot`; returns how many, at least one unless the output is full. Adds
    // the items it completed to `produced`, which is below `room`.
    virtual int take(const Sample* averaged, int frames, std::uint64_t snapshot) = 0;
    // The samples that follow were received with settings that were changed meanwhile.
    virtual void mark_retuned() = 0;
    // Frame timing slipped before them; the value of the tag.
    virtual void mark_slipped(const pmt::pmt_t& misplaced) = 0;

    const kernel::preamble_folder d_folder;
    kernel::fc32* d_out = nullptr;
    int d_room = 0;               // output items
    int d_produced = 0;           // of them
    std::vector<int> d_saturated; // of the frames last folded

private:
    void collect_tags(int available)
    {
        const std::uint64_t begin = std::max(d_tags_read_to, d_items_read);
        const std::uint64_t end = d_items_read + available;
        if (end <= begin)
            return;
        std::vector<gr::tag_t> tags;
        // Of former starts.
        const std::uint64_t before = d_items_read - this->nitems_read(0);
        this->get_tags_in_range(tags, 0, begin - before, end - before);
        for (gr::tag_t& tag : tags)
            tag.offset += before;
        d_tags_read_to = end;
        d_events.add(std::move(tags));
    }

    void pass(const Sample* samples, std::uint64_t count)
    {
        d_mean.take(samples, count, d_walk.position());
        d_walk.pass(samples, count);
    }

    void skip(std::uint64_t samples)
    {
        if (samples > 0)
            d_mean.interrupt();
        d_walk.skip(samples);
    }

    // False when the output is full.
    bool
    take_whole_frames(const Sample* samples, std::uint64_t& consumed, std::uint64_t end)
    {
        while (true) {
            const std::uint64_t lead = std::min(end - consumed, d_walk.lead());
            pass(samples + consumed, lead);
            consumed += lead;
            const std::uint64_t whole = d_walk.whole_frames(end - consumed);
            if (whole == 0)
                return true;
            const int taken =
                d_produced < d_room ? take(samples + consumed, whole, d_walk.frame()) : 0;
            if (taken == 0)
                return false;
            const std::uint64_t count = d_walk.span(taken);
            pass(samples + consumed, count);
            consumed += count;
            d_snapshots += taken;
        }
    }

    void take_event(const input_events::event& event)
    {
        if (event.retuned || (event.usable && !d_usable))
            mark_retuned();
        d_usable = event.usable;
        d_samples_lost += event.lost;
        d_gaps += event.lost > 0;
        skip(event.lost);
    }

    void follow_frames()
    {
        const std::uint64_t lost = d_walk.decide();
        if (lost == 0)
            return;
        d_mean.interrupt();
        d_logger->warn("frame timing slipped by {:d} samples; resynchronised", lost);
        // The next rx_time counts them as well, and by how many whole frames more.
        d_events.expect_loss(lost, d_folder.frame_length());
        mark_slipped(slip_value(d_walk.misplaced()));
        d_frames_moved += 1;
        d_samples_moved += lost;
    }

    // Items of the input, which GNU Radio counts anew when a flowgraph is started again.
    std::uint64_t d_items_read = 0;
    std::uint64_t d_tags_read_to = 0; // item up to which tags were read
    input_events d_events;
    bool d_usable = true; // the next sample
    kernel::frame_walk d_walk;
    kernel::frame_mean d_mean;

    kernel::counter d_snapshots;
    kernel::counter d_samples_lost;
    kernel::counter d_gaps;
    kernel::counter d_frames_moved;
    kernel::counter d_samples_moved;
};

// A folded vector per frame; its index is tagged when the one before it is not its
// neighbour.
template <class Sample>
class vector_fold : public preamble_fold_impl<Sample>
{
public:
    vector_fold(const kernel::preamble_folder& folder,
                double sample_rate,
                std::uint64_t frame_offset)
        : gr::block("preamble_fold",
                    gr::io_signature::make(1, 1, sizeof(Sample)),
                    gr::io_signature::make(1, 1, vector_bytes(folder))),
          preamble_fold_impl<Sample>(folder, sample_rate, frame_offset)
    {
    }

    bool start() override
    {
        d_expected.reset(); // what waited for the next block is lost
        return preamble_fold_impl<Sample>::start();
    }

protected:
    int take(const Sample* averaged, int frames, std::uint64_t snapshot) override
    {
        const int count = std::min(frames, this->d_room - this->d_produced);
        const auto tag = [&](const pmt::pmt_t& key,
                             const pmt::pmt_t& value,
                             int frame = 0) {
            const std::uint64_t item = this->nitems_written(0) + this->d_produced + frame;
            this->add_item_tag(0, item, key, value);
        };
        if (d_expected != snapshot)
            tag(keys::snapshot, pmt::from_uint64(snapshot));
        if (d_retuned)
            tag(keys::retuned, pmt::from_uint64(1));
        d_retuned = false;
        for (const pmt::pmt_t& misplaced : d_slips)
            tag(keys::slipped, misplaced);
        d_slips.clear();
        d_noise.resize(count);
        this->d_folder.fold(averaged,
                            count,
                            this->d_out +
                                this->d_produced * this->d_folder.symbol_length(),
                            d_noise.data(),
                            this->d_saturated);
        tag(keys::noise, noise_value(d_noise.data(), count));
        for (const int frame : this->d_saturated)
            tag(keys::saturated, pmt::from_uint64(1), frame);
        this->d_produced += count;
        d_expected = snapshot + count;
        return count;
    }

    void mark_retuned() override { d_retuned = true; }
    void mark_slipped(const pmt::pmt_t& misplaced) override
    {
        d_slips.push_back(misplaced);
    }

private:
    std::optional<std::uint64_t> d_expected;
    bool d_retuned = false;
    std::vector<pmt::pmt_t> d_slips;             // before the next frame
    std::vector<kernel::snapshot_noise> d_noise; // of the frames last folded
};

// The tones of a phase group, or its snapshots together.
template <class Sample>
class group_fold : public group_block<preamble_fold_impl<Sample>>
{
public:
    group_fold(const kernel::preamble_folder& folder,
               double sample_rate,
               std::uint64_t frame_offset,
               std::unique_ptr<kernel::doppler_transform> transform,
               int group_length)
        : gr::block(
              "preamble_fold",
              gr::io_signature::make(1, 1, sizeof(Sample)),
              gr::io_signature::make(1, 1, transform->rows() * vector_bytes(folder))),
          group_block<preamble_fold_impl<Sample>>(std::move(transform),
                                                  group_length,
                                                  folder.symbol_length(),
                                                  folder,
                                                  sample_rate,
                                                  frame_offset)
    {
    }

protected:
    int take(const Sample* averaged, int frames, std::uint64_t snapshot) override
    {
        auto& collector = this->d_collector;
        if (collector.must_end_before(snapshot)) {
            this->d_produced += this->end_group(this->d_out, this->d_produced);
            if (this->d_produced == this->d_room)
                return 0;
        }
        if (d_retuned)
            this->mark_group_retuned();
        d_retuned = false;
        collector.collect_in(this->d_out + this->d_produced * collector.size());
        const int count = collector.add(
            snapshot,
            std::min(frames, collector.BATCH),
            [&](int n, kernel::fc32* folded, kernel::snapshot_noise* noise) {
                this->d_folder.fold(averaged, n, folded, noise, this->d_saturated);
                return n;
            });
        collector.note_saturated(this->d_saturated.size());
        if (collector.is_full())
            this->d_produced += this->end_group(this->d_out, this->d_produced);
        return count;
    }

    // The group at hand may end before the next frame.
    void mark_retuned() override { d_retuned = true; }
    void mark_slipped(const pmt::pmt_t& misplaced) override
    {
        this->mark_group_slipped(misplaced);
    }

private:
    bool d_retuned = false;
};

namespace {

template <template <class> class Fold, class... Further>
preamble_fold::sptr make_fold(const std::string& item_type,
                              const kernel::preamble_folder& folder,
                              double sample_rate,
                              std::uint64_t frame_offset,
                              Further&&... further)
{
    kernel::require(std::isfinite(sample_rate) && sample_rate > 0,
                    "preamble_fold: sample_rate must be positive",
                    sample_rate);
    kernel::require(item_type == "fc32" || item_type == "sc16",
                    "preamble_fold: item_type must be 'fc32' or 'sc16'",
                    "'" + item_type + "'");
    const auto of = [&](auto sample) -> preamble_fold::sptr {
        return gnuradio::make_block_sptr<Fold<decltype(sample)>>(
            folder, sample_rate, frame_offset, std::forward<Further>(further)...);
    };
    return item_type == "sc16" ? of(kernel::sc16{}) : of(kernel::fc32{});
}

} // namespace

preamble_fold::sptr preamble_fold::make(int frame_length,
                                        int first_averaged,
                                        int repetitions,
                                        double sample_rate,
                                        std::uint64_t frame_offset,
                                        const std::string& item_type,
                                        int symbol_length)
{
    return make_fold<vector_fold>(
        item_type,
        { frame_length, first_averaged, repetitions, symbol_length },
        sample_rate,
        frame_offset);
}

preamble_fold::sptr preamble_fold::tones(const std::vector<std::complex<double>>& weights,
                                         int group_length,
                                         int frame_length,
                                         int first_averaged,
                                         int repetitions,
                                         double sample_rate,
                                         std::uint64_t frame_offset,
                                         const std::string& item_type,
                                         int symbol_length)
{
    return make_fold<group_fold>(
        item_type,
        { frame_length, first_averaged, repetitions, symbol_length },
        sample_rate,
        frame_offset,
        std::make_unique<kernel::tone_accumulator>(weights, group_length, symbol_length),
        group_length);
}

preamble_fold::sptr preamble_fold::collected(int group_length,
                                             int frame_length,
                                             int first_averaged,
                                             int repetitions,
                                             double sample_rate,
                                             std::uint64_t frame_offset,
                                             const std::string& item_type,
                                             int symbol_length)
{
    return make_fold<group_fold>(
        item_type,
        { frame_length, first_averaged, repetitions, symbol_length },
        sample_rate,
        frame_offset,
        std::make_unique<kernel::collected_snapshots>(group_length),
        group_length);
}

} // namespace gr::wiforce
