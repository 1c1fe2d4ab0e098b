// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/recording/recorded_frames.h"
#include "kernel/require.h"
#include "tag_values.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/recording_source.h>

#include <algorithm>

namespace gr::wiforce {

class recording_source_impl : public recording_source
{
public:
    recording_source_impl(const std::string& path,
                          const std::string& datatype,
                          const std::vector<kernel::recording::segment>& segments,
                          const kernel::preamble_folder& folder,
                          std::uint64_t frame_offset,
                          std::uint64_t header_bytes)
        : gr::sync_block("recording_source",
                         gr::io_signature::make(0, 0, 0),
                         gr::io_signature::make(
                             1, 1, folder.symbol_length() * sizeof(kernel::fc32))),
          d_frames(path, datatype, segments, folder, frame_offset, header_bytes),
          d_reader(d_frames)
    {
    }

    bool start() override
    {
        d_expected.reset(); // what waited for the next block is lost
        return recording_source::start();
    }

    int work(int noutput_items,
             gr_vector_const_void_star&,
             gr_vector_void_star& output_items) override
    {
        auto* out = static_cast<kernel::fc32*>(output_items[0]);
        int produced = 0;
        while (produced < noutput_items && d_reader.fill()) {
            const std::uint64_t first = d_reader.rest().frame;
            for (; d_slips < d_frames.misplaced().size(); d_slips++) {
                const auto& misplaced = d_frames.misplaced()[d_slips];
                d_logger->warn("frame timing slipped by {:d} samples before frame {:d}; "
                               "resynchronised",
                               d_frames.lost()[d_slips],
                               misplaced.second);
                tag(produced, keys::slipped, slip_value(misplaced));
            }
            for (; d_retunings < d_frames.retuned().size(); d_retunings++)
                tag(produced, keys::retuned, pmt::from_uint64(1));
            d_noise.resize(noutput_items - produced);
            const int count = d_reader.fold(noutput_items - produced,
                                            out + produced * d_frames.symbol_length(),
                                            d_noise.data());
            if (count == 0)
                continue;
            tag(produced, keys::noise, noise_value(d_noise.data(), count));
            if (d_expected != first)
                tag(produced, keys::snapshot, pmt::from_uint64(first));
            for (const int frame : d_reader.saturated())
                tag(produced + frame, keys::saturated, pmt::from_uint64(1));
            produced += count;
            d_expected = first + count;
        }
        return produced > 0 ? produced : WORK_DONE;
    }

    std::uint64_t snapshots() const override { return d_frames.folded(); }
    std::uint64_t frames_moved() const override { return d_frames.frames_moved(); }
    std::uint64_t samples_missing() const override { return d_frames.samples_missing(); }

private:
    void tag(int item, const pmt::pmt_t& key, const pmt::pmt_t& value)
    {
        add_item_tag(0, nitems_written(0) + item, key, value);
    }

    kernel::recorded_frames d_frames;
    kernel::frame_reader d_reader;
    std::vector<kernel::snapshot_noise> d_noise; // of the frames last folded
    std::optional<std::uint64_t> d_expected;     // index of the next frame without a gap
    std::size_t d_slips = 0, d_retunings = 0;    // that are tagged
};

recording_source::sptr recording_source::make(const std::string& path,
                                              const std::string& datatype,
                                              const std::vector<segment>& segments,
                                              int frame_length,
                                              int first_averaged,
                                              int repetitions,
                                              std::uint64_t frame_offset,
                                              std::uint64_t header_bytes,
                                              int symbol_length,
                                              const std::vector<std::size_t>& retuned)
{
    std::vector<kernel::recording::segment> runs;
    for (const auto& [file_sample, global_index, length] : segments)
        runs.push_back({ file_sample, global_index, length });
    for (const std::size_t number : retuned) {
        kernel::require(number < runs.size(),
                        "recording: retuned must be numbers of segments",
                        number);
        runs[number].retuned = true;
    }
    return gnuradio::make_block_sptr<recording_source_impl>(
        path,
        datatype,
        runs,
        kernel::preamble_folder(frame_length, first_averaged, repetitions, symbol_length),
        frame_offset,
        header_bytes);
}

} // namespace gr::wiforce
