// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../counter.h"
#include "../types.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * The samples of a recording on disk, a part of them in memory at a time.
 *
 * The file holds runs of samples ("segments") of a stream; between two of them samples
 * were lost. A file that is shorter than its segments say, or is cut short while it is
 * read, is read as far as it goes.
 */
class recording
{
public:
    struct segment {
        std::uint64_t file_sample;  // of its first sample
        std::uint64_t global_index; // of its first sample in the stream
        std::uint64_t length;       // samples
    };

    // `datatype` is "ci16_le" or "cf32_le"; `held_samples` follow each other in memory at
    // least. Throws std::invalid_argument when the file cannot be opened or holds no
    // sample, or when segments overlap or go back.
    recording(const std::string& path,
              const std::string& datatype,
              const std::vector<segment>& segments,
              std::uint64_t header_bytes,
              std::uint64_t held_samples);
    ~recording();
    recording(const recording&) = delete;
    recording& operator=(const recording&) = delete;

    // Samples that segments promise and the file does not hold, as far as is known.
    std::uint64_t samples_missing() const { return d_samples_missing; }

    // Goes to the next segment; returns its position in the stream, counted from the
    // first one's start, or nothing at the end.
    std::optional<std::uint64_t> next_segment();

    // Samples of the segment in memory: those read and not dropped.
    std::uint64_t held() const { return d_held; }
    template <class Visitor>
    void visit(const Visitor& visitor) const
    {
        const char* first = d_buffer.data() + d_first * d_sample_bytes;
        if (d_is_integer)
            visitor(reinterpret_cast<const sc16*>(first));
        else
            visitor(reinterpret_cast<const fc32*>(first));
    }
    void drop(std::uint64_t samples);
    // Reads the samples behind them; false at the end of the segment.
    bool read_on();

private:
    void open(const std::string& path);
    std::uint64_t samples_in_file() const;
    void clip(const std::vector<segment>& segments);

    const bool d_is_integer;
    const std::uint64_t d_sample_bytes;
    const std::uint64_t d_header_bytes;
    int d_file = -1;
    std::vector<segment> d_segments; // what the file held when it was opened
    std::size_t d_next_segment = 0;
    std::uint64_t d_next_sample = 0; // to be read, in the file
    std::uint64_t d_unread = 0;      // samples of the segment
    std::vector<char> d_buffer;
    std::uint64_t d_first = 0; // sample in the buffer
    std::uint64_t d_held = 0;
    counter d_samples_missing;
};

} // namespace gr::wiforce::kernel
