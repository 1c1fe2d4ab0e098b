// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "group_block.h"
#include "input_events.h"
#include "kernel/fold/frame_mean.h"
#include "kernel/fold/frame_walk.h"
#include <gnuradio/wiforce/preamble_fold.h>

#include <optional>

namespace gr::wiforce {

// Walks over the frames between the gaps that rx_time reports or the frames' place shows.
// Derived classes process the frames. Sample is kernel::fc32 or kernel::sc16.
template <class Sample>
class preamble_fold_impl : public preamble_fold
{
public:
    preamble_fold_impl(const kernel::preamble_folder& folder,
                       double sample_rate,
                       std::uint64_t frame_offset);

    bool start() override;
    void forecast(int noutput_items, gr_vector_int& ninput_items_required) override;
    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;

    std::uint64_t snapshots() const override { return d_snapshots; }
    std::uint64_t samples_lost() const override { return d_samples_lost; }
    std::uint64_t gaps() const override { return d_gaps; }
    void expect_carrier(double frequency_hz) override
    {
        d_events.expect_carrier(frequency_hz);
    }
    double refused_rate() const override { return d_events.refused_rate(); }
    double refused_carrier() const override { return d_events.refused_carrier(); }
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
    void collect_tags(int available);
    void pass(const Sample* samples, std::uint64_t count);
    void skip(std::uint64_t samples);
    bool
    take_whole_frames(const Sample* samples, std::uint64_t& consumed, std::uint64_t end);
    void take_event(const input_events::event& event);
    void follow_frames();

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
                std::uint64_t frame_offset);

    bool start() override
    {
        d_expected.reset(); // what waited for the next block is lost
        return preamble_fold_impl<Sample>::start();
    }

protected:
    int take(const Sample* averaged, int frames, std::uint64_t snapshot) override;
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
               int group_length);

protected:
    int take(const Sample* averaged, int frames, std::uint64_t snapshot) override;
    void mark_retuned() override { this->mark_group_retuned(); }
    void mark_slipped(const pmt::pmt_t& misplaced) override
    {
        this->mark_group_slipped(misplaced);
    }
};

} // namespace gr::wiforce
