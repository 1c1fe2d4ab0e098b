// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "preamble_folder.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * A recording on disk, mapped: where its whole frames lie.
 *
 * The file holds runs of samples ("segments") of a stream; between two of them samples
 * were lost. Frames lie on the grid of that stream, which starts frame_offset samples
 * after the first segment's first one. A frame is whole when all samples that are
 * averaged are there.
 */
class recording
{
public:
    struct segment {
        std::uint64_t file_sample;  // of its first sample
        std::uint64_t global_index; // of its first sample in the stream
        std::uint64_t length;       // samples
    };

    // Whole frames that follow each other without a gap.
    struct run {
        std::uint64_t file_byte; // of the first averaged sample
        std::uint64_t snapshot;  // index of the first frame on the grid
        std::uint64_t frames;
        // Of all samples without a gap around them, counted from the recording's first.
        std::uint64_t begin;
        std::uint64_t end;
    };

    // Throws std::invalid_argument when the file cannot be opened or holds no sample, or
    // when segments overlap or go back. Segments may reach beyond the end of the file.
    recording(const std::string& path,
              std::size_t sample_bytes,
              std::uint64_t header_bytes,
              const std::vector<segment>& segments,
              const preamble_folder& folder,
              std::uint64_t frame_offset);
    ~recording();
    recording(const recording&) = delete;
    recording& operator=(const recording&) = delete;

    const std::vector<run>& runs() const { return d_runs; }
    // Samples that segments promise and the file does not hold.
    std::uint64_t samples_missing() const { return d_samples_missing; }

    // Tells that samples were lost before a position inside the run, of which no segment
    // told: the frames behind it are others. Runs before it stay as they are.
    void lose(std::uint64_t position, std::uint64_t samples);

    const char* at(std::uint64_t file_byte) const { return d_map + file_byte; }
    // Whether the file still reaches up to there: another program may cut it short.
    // Beyond its end the last page reads as zeros, the pages behind end the process
    // (mapped_read.h).
    bool reaches(std::uint64_t file_byte) const;

    // Gives the memory of all bytes before this one back: a long recording takes no more
    // than a short one.
    void release_before(std::uint64_t file_byte);

private:
    void map(const std::string& path);
    void unmap();
    void find_parts(const std::vector<segment>& segments);
    void find_runs();

    const preamble_folder d_folder;
    const std::size_t d_sample_bytes;
    const std::uint64_t d_header_bytes;
    const std::uint64_t d_frame_offset;
    int d_file = -1;
    const char* d_map = nullptr;
    std::uint64_t d_size = 0;
    std::uint64_t d_released = 0;
    std::vector<segment> d_parts; // what is there; indices count from the first
    std::vector<run> d_runs;
    std::uint64_t d_samples_missing = 0;
};

} // namespace gr::wiforce::kernel
