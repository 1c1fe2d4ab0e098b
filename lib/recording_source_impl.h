// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "counter.h"
#include "group_stream.h"
#include "kernel/fold/mapped_read.h"
#include "kernel/fold/recording.h"
#include "kernel/timing/frame_watch.h"
#include <gnuradio/wiforce/recording_source.h>

#include <memory>

namespace gr::wiforce {

// Walks a recording's whole frames in order.
class frame_walk
{
public:
    frame_walk(std::unique_ptr<kernel::recording> recording,
               const kernel::preamble_folder& folder,
               std::uint64_t frame_offset,
               bool integers);

    std::uint64_t samples_missing() const
    {
        return d_recording->samples_missing() + d_samples_cut;
    }
    std::uint64_t folded() const { return d_folded; } // frames so far
    std::uint64_t frames_moved() const { return d_frames_moved; }
    bool at_end() const { return d_run == d_recording->runs().size(); }
    bool at_run_start() const { return d_frame == 0; }
    std::uint64_t snapshot() const; // index of the next frame
    // Folds up to `count` frames of the run at hand; returns how many: none when the file
    // was cut short since it was mapped, which ends the walk.
    int fold(int count, kernel::fc32* folded);
    // Of the frames last folded, those that hold samples at full scale.
    const std::vector<int>& saturated() const { return d_saturated; }

private:
    template <class Sample>
    void fold(const char* averaged, int frames, kernel::fc32* folded);
    template <class Read>
    bool guarded(const Read& read, std::uint64_t end_byte);
    std::uint64_t next_frame() const; // its position on the grid
    bool follow_frames();
    void end_here();

    std::unique_ptr<kernel::recording> d_recording;
    kernel::preamble_folder d_folder;
    std::uint64_t d_frame_offset;
    bool d_integers;
    kernel::frame_watch d_watch;
    std::size_t d_run = 0;
    std::uint64_t d_frame = 0; // in the run
    counter d_folded;
    counter d_frames_moved;
    std::vector<int> d_saturated;
    counter d_samples_cut; // of whole frames that the file lost meanwhile
};

// What both forms of the block tell of the recording.
class walking_source : public recording_source
{
public:
    std::uint64_t snapshots() const override { return d_walk.folded(); }
    std::uint64_t frames_moved() const override { return d_walk.frames_moved(); }
    std::uint64_t samples_missing() const override { return d_walk.samples_missing(); }

protected:
    explicit walking_source(frame_walk walk) : d_walk(std::move(walk)) {}

    frame_walk d_walk;
};

class folded_recording_source : public walking_source
{
public:
    explicit folded_recording_source(frame_walk walk);

    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;
};

class tone_recording_source : public group_block<walking_source>
{
public:
    tone_recording_source(frame_walk walk,
                          std::unique_ptr<doppler_transform> transform,
                          int group_length);

    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;
};

} // namespace gr::wiforce
