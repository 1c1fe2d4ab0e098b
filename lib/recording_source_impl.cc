// SPDX-License-Identifier: GPL-3.0-or-later
#include "recording_source_impl.h"

#include "kernel/require.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/logger.h>
#include <gnuradio/wiforce/names.h>

#include <algorithm>

namespace gr::wiforce {

namespace {

const pmt::pmt_t saturated_key = pmt::mp(names::SATURATED);
const pmt::pmt_t snapshot_key = pmt::mp(names::SNAPSHOT);

bool is_integer(const std::string& datatype)
{
    kernel::require(datatype == "ci16_le" || datatype == "cf32_le",
                    "recording_source",
                    "datatype",
                    "must be 'ci16_le' or 'cf32_le'",
                    "'" + datatype + "'");
    return datatype == "ci16_le";
}

frame_walk walk_over(const std::string& path,
                     const std::string& datatype,
                     const std::vector<recording_source::segment>& segments,
                     const kernel::preamble_folder& folder,
                     std::uint64_t frame_offset,
                     std::uint64_t header_bytes)
{
    const bool integers = is_integer(datatype);
    std::vector<kernel::recording::segment> parts;
    for (const auto& [file_sample, global_index, length] : segments)
        parts.push_back({ file_sample, global_index, length });
    return frame_walk(std::make_unique<kernel::recording>(path,
                                                          integers ? sizeof(kernel::sc16)
                                                                   : sizeof(kernel::fc32),
                                                          header_bytes,
                                                          parts,
                                                          folder,
                                                          frame_offset),
                      folder,
                      frame_offset,
                      integers);
}

} // namespace

recording_source::sptr recording_source::make(const std::string& path,
                                              const std::string& datatype,
                                              const std::vector<segment>& segments,
                                              int frame_length,
                                              int first_averaged,
                                              int repetitions,
                                              std::uint64_t frame_offset,
                                              std::uint64_t header_bytes)
{
    const kernel::preamble_folder folder(frame_length, first_averaged, repetitions);
    return gnuradio::make_block_sptr<folded_recording_source>(
        walk_over(path, datatype, segments, folder, frame_offset, header_bytes));
}

recording_source::sptr
recording_source::tones(const std::string& path,
                        const std::string& datatype,
                        const std::vector<segment>& segments,
                        const std::vector<std::complex<double>>& weights,
                        int group_length,
                        int frame_length,
                        int first_averaged,
                        int repetitions,
                        std::uint64_t frame_offset,
                        std::uint64_t header_bytes)
{
    const kernel::preamble_folder folder(frame_length, first_averaged, repetitions);
    auto transform = std::make_unique<doppler_tones>(weights, group_length);
    return gnuradio::make_block_sptr<tone_recording_source>(
        walk_over(path, datatype, segments, folder, frame_offset, header_bytes),
        std::move(transform),
        group_length);
}

frame_walk::frame_walk(std::unique_ptr<kernel::recording> recording,
                       const kernel::preamble_folder& folder,
                       std::uint64_t frame_offset,
                       bool integers)
    : d_recording(std::move(recording)),
      d_folder(folder),
      d_frame_offset(frame_offset),
      d_integers(integers),
      d_watch(folder.frame_length(), frame_offset)
{
}

std::uint64_t frame_walk::snapshot() const
{
    return d_recording->runs()[d_run].snapshot + d_frame;
}

std::uint64_t frame_walk::next_frame() const
{
    return d_frame_offset + snapshot() * d_folder.frame_length();
}

template <class Sample>
void frame_walk::fold(const char* averaged, int frames, kernel::fc32* folded)
{
    const auto* samples = reinterpret_cast<const Sample*>(averaged);
    d_folder.fold(samples, frames, folded);
    d_folder.saturated(samples, frames, d_saturated);
}

// Whether the file still held what read() took, up to end_byte; if not, the walk ends.
template <class Read>
bool frame_walk::guarded(const Read& read, std::uint64_t end_byte)
{
    if (kernel::mapped_read::succeeds(read) && d_recording->reaches(end_byte))
        return true;
    end_here();
    d_saturated.clear();
    return false;
}

int frame_walk::fold(int count, kernel::fc32* folded)
{
    const auto& run = d_recording->runs()[d_run];
    const std::uint64_t stride = d_folder.frame_length();
    if (d_frame == 0)
        d_watch.restart(run.begin);
    const int frames =
        std::min<std::uint64_t>({ std::uint64_t(count),
                                  run.frames - d_frame,
                                  (d_watch.decision() - next_frame()) / stride });
    const std::size_t sample = d_integers ? sizeof(kernel::sc16) : sizeof(kernel::fc32);
    const std::uint64_t byte = run.file_byte + d_frame * stride * sample;
    const std::uint64_t samples = (frames - 1) * stride + d_folder.averaged_length();
    const char* averaged = d_recording->at(byte);
    d_saturated.reserve(frames); // a guarded read may be left anywhere: no memory in it
    const auto read = [&] {
        if (d_integers)
            fold<kernel::sc16>(averaged, frames, folded);
        else
            fold<kernel::fc32>(averaged, frames, folded);
    };
    if (!guarded(read, byte + samples * sample))
        return 0;
    d_recording->release_before(byte);
    d_folded += frames;
    d_frame += frames;
    if (next_frame() == d_watch.decision() && next_frame() <= run.end && !follow_frames())
        return frames;
    if (d_frame == d_recording->runs()[d_run].frames) {
        d_run++;
        d_frame = 0;
    }
    return frames;
}

// As preamble_fold does. False when the file was cut short.
bool frame_walk::follow_frames()
{
    const auto& run = d_recording->runs()[d_run];
    const std::uint64_t count = d_watch.averaged_samples();
    const std::uint64_t position = next_frame(), first = position - count;
    const std::size_t sample = d_integers ? sizeof(kernel::sc16) : sizeof(kernel::fc32);
    // The frame at hand begins so many samples before its averaged part.
    const std::uint64_t end = run.file_byte + d_frame * d_folder.frame_length() * sample -
                              d_folder.first_averaged() * sample;
    const char* samples = d_recording->at(end - count * sample);
    const auto read = [&] {
        if (d_integers)
            d_watch.take(reinterpret_cast<const kernel::sc16*>(samples), count, first);
        else
            d_watch.take(reinterpret_cast<const kernel::fc32*>(samples), count, first);
    };
    if (!guarded(read, end))
        return false;
    const int shift = d_watch.decide();
    if (shift > 0) {
        gr::logger("recording_source")
            .warn("frames come {:d} samples late: followed", shift);
        d_frames_moved += 1;
        d_recording->lose(position, d_folder.frame_length() - shift);
    }
    return true;
}

void frame_walk::end_here()
{
    const auto& runs = d_recording->runs();
    std::uint64_t frames = runs[d_run].frames - d_frame;
    for (std::size_t run = d_run + 1; run < runs.size(); run++)
        frames += runs[run].frames;
    d_samples_cut += frames * d_folder.frame_length();
    d_run = runs.size();
    d_frame = 0;
}

folded_recording_source::folded_recording_source(frame_walk walk)
    : gr::block("recording_source",
                gr::io_signature::make(0, 0, 0),
                gr::io_signature::make(1, 1, FOLDED_BYTES)),
      walking_source(std::move(walk))
{
}

int folded_recording_source::general_work(int noutput_items,
                                          gr_vector_int&,
                                          gr_vector_const_void_star&,
                                          gr_vector_void_star& output_items)
{
    auto* out = static_cast<kernel::fc32*>(output_items[0]);
    int produced = 0;
    while (produced < noutput_items && !d_walk.at_end()) {
        if (d_walk.at_run_start())
            add_item_tag(0,
                         nitems_written(0) + produced,
                         snapshot_key,
                         pmt::from_uint64(d_walk.snapshot()));
        const int frames =
            d_walk.fold(noutput_items - produced, out + produced * kernel::FFT_LENGTH);
        for (const int frame : d_walk.saturated())
            add_item_tag(0,
                         nitems_written(0) + produced + frame,
                         saturated_key,
                         pmt::from_uint64(1));
        produced += frames;
    }
    return produced > 0 ? produced : WORK_DONE;
}

tone_recording_source::tone_recording_source(frame_walk walk,
                                             std::unique_ptr<doppler_transform> transform,
                                             int group_length)
    : gr::block("recording_source",
                gr::io_signature::make(0, 0, 0),
                gr::io_signature::make(1, 1, transform->rows() * FOLDED_BYTES)),
      group_block(std::move(transform), group_length, std::move(walk))
{
}

int tone_recording_source::general_work(int noutput_items,
                                        gr_vector_int&,
                                        gr_vector_const_void_star&,
                                        gr_vector_void_star& output_items)
{
    auto* out = static_cast<kernel::fc32*>(output_items[0]);
    int produced = 0;
    while (produced < noutput_items && !d_walk.at_end()) {
        const bool cut = d_stream.must_close_before(d_walk.snapshot());
        if (!cut) {
            const int count = std::min(BATCH, d_stream.room(d_walk.snapshot()));
            d_stream.accept(d_walk.fold(count, d_stream.reserve(d_walk.snapshot())));
            d_stream.note_saturated(d_walk.saturated().size());
        }
        if (cut || d_stream.is_full())
            produced += close_group(out, produced);
    }
    return produced > 0 ? produced : WORK_DONE;
}

} // namespace gr::wiforce
