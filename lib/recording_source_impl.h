// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/recording/recorded_frames.h"
#include <gnuradio/wiforce/recording_source.h>

namespace gr::wiforce {

class recording_source_impl : public recording_source
{
public:
    recording_source_impl(const std::string& path,
                          const std::string& datatype,
                          const std::vector<kernel::recording::segment>& segments,
                          const kernel::preamble_folder& folder,
                          std::uint64_t frame_offset,
                          std::uint64_t header_bytes);

    int work(int noutput_items,
             gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

    std::uint64_t snapshots() const override { return d_frames.folded(); }
    std::uint64_t frames_moved() const override { return d_frames.frames_moved(); }
    std::uint64_t samples_missing() const override { return d_frames.samples_missing(); }

private:
    void tag(int item, const pmt::pmt_t& key, std::uint64_t value);

    kernel::recorded_frames d_frames;
    kernel::frame_reader d_reader;
    std::vector<kernel::snapshot_noise> d_noise; // of the frames last folded
    std::optional<std::uint64_t> d_expected;     // index of the next frame without a gap
    std::size_t d_slips = 0;                     // that are tagged
};

} // namespace gr::wiforce
