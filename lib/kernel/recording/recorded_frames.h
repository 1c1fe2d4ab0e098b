// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../fold/frame_walk.h"
#include "../types.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * A part of a file in memory, as one thread at a time looks at it.
 *
 * Where the file was cut off meanwhile, or cannot be read, there are zeros: the signal
 * (SIGBUS) that would end the process is handled for the thread that looks.
 *
 * The handler is the whole process's, from the first look on. A program's own handler of
 * SIGBUS gets the signals of other pages, and is set aside again by the next part (32 MB)
 * that is looked at. Copies instead of the mapping took up to 1.5 times as long
 * (docs/data/optimisations.csv).
 */
class mapped_part
{
public:
    // The path is for messages.
    mapped_part(int file, std::string path) : d_file(file), d_path(std::move(path)) {}
    ~mapped_part();
    mapped_part(const mapped_part&) = delete;
    mapped_part& operator=(const mapped_part&) = delete;

    // Calls look(bytes) with `count` bytes from a place in the file on; returns the place
    // of the first byte so far that could not be read. Throws std::invalid_argument where
    // the file cannot be mapped.
    template <class Look>
    std::uint64_t look(std::uint64_t first, std::uint64_t count, const Look& look)
    {
        const looking now(*this);
        look(at(first, count));
        return d_unreadable;
    }

    // Puts zeros from an address of the part on; false where it is none. For the handler.
    bool replace(const void* address);

private:
    // The part that the signal is handled for, while it exists.
    struct looking {
        explicit looking(mapped_part& part);
        ~looking();
    };

    const char* at(std::uint64_t first, std::uint64_t count);
    void map(std::uint64_t first, std::uint64_t count);

    const int d_file;
    const std::string d_path;
    char* d_memory = nullptr;
    std::size_t d_bytes = 0;
    std::uint64_t d_first = 0; // of the bytes, in the file
    std::vector<char> d_aligned;
    std::atomic<std::uint64_t> d_unreadable{ ~std::uint64_t(0) };
};

/*
 * The samples of a recording on disk.
 *
 * The file holds runs of samples ("segments") of a stream; between two of them samples
 * were lost. A file that is shorter than its segments say, or is cut short while it is
 * read, is read as far as it goes. One thread walks over the segments, several may read.
 */
class recording
{
public:
    struct segment {
        std::uint64_t file_sample;  // of its first sample
        std::uint64_t global_index; // of its first sample in the stream
        std::uint64_t length;       // samples
        bool retuned = false;       // the oscillators have new phases from here on
    };

    // `datatype` is "ci16_le" or "cf32_le". Throws std::invalid_argument when the file
    // cannot be opened or holds no sample, or when segments overlap or go back.
    recording(const std::string& path,
              const std::string& datatype,
              const std::vector<segment>& segments,
              std::uint64_t header_bytes);
    ~recording();
    recording(const recording&) = delete;
    recording& operator=(const recording&) = delete;

    // Samples that segments promise and the file does not hold, as far as is known.
    std::uint64_t samples_missing() const;

    // Goes to the next segment; returns its position in the stream, counted from the
    // first one's start, or nothing at the end.
    std::optional<std::uint64_t> next_segment();
    // Whether the device was retuned before the present one.
    bool is_retuned() const { return d_segments[d_next_segment - 1].retuned; }

    // Samples of the segment that lie ahead in the file as it is now.
    std::uint64_t ahead();
    // Place of the first of them in the file.
    std::uint64_t sample() const { return d_next_sample; }
    void pass(std::uint64_t samples)
    {
        d_next_sample += samples;
        d_unread -= samples;
    }

    std::uint64_t sample_bytes() const { return d_sample_bytes; }
    // What looks at samples, a thread at a time.
    std::unique_ptr<mapped_part> part() const
    {
        return std::make_unique<mapped_part>(d_file, d_path);
    }
    // Calls the visitor with samples from a place in the file on, in their type; returns
    // how many of them the file held: the others were zeros.
    template <class Visitor>
    std::uint64_t look(mapped_part& part,
                       std::uint64_t sample,
                       std::uint64_t count,
                       const Visitor& visitor) const
    {
        const std::uint64_t first = d_header_bytes + sample * d_sample_bytes;
        return held(sample,
                    count,
                    part.look(first, count * d_sample_bytes, [&](const char* samples) {
                        if (d_is_integer)
                            visitor(reinterpret_cast<const sc16*>(samples));
                        else
                            visitor(reinterpret_cast<const fc32*>(samples));
                    }));
    }

private:
    void open();
    std::uint64_t samples_in_file() const;
    std::uint64_t samples_before(std::uint64_t byte) const;
    void note_end(std::uint64_t sample) const;
    std::uint64_t
    held(std::uint64_t sample, std::uint64_t count, std::uint64_t unreadable) const;

    const std::string d_path;
    const bool d_is_integer;
    const std::uint64_t d_sample_bytes;
    const std::uint64_t d_header_bytes;
    int d_file = -1;
    std::vector<segment> d_segments; // as they are stated
    std::size_t d_next_segment = 0;
    std::uint64_t d_next_sample = 0; // to be read, in the file
    std::uint64_t d_unread = 0;      // samples of the segment
    // Of the file, as far as is known.
    mutable std::atomic<std::uint64_t> d_end{ ~std::uint64_t(0) };
};

// Frames that follow each other in a file.
struct frame_run {
    std::uint64_t sample; // first averaged one of the first frame, in the file
    std::uint64_t frame;  // its index on the grid
    std::uint64_t count;
};

/*
 * The whole frames of a recording, in order.
 *
 * Frames lie on a grid that starts frame_offset samples after the first segment's first
 * one. Where they come elsewhere, they are followed (see frame_walk). Of the samples,
 * only those that are watched for this are read here. One thread at a time takes runs of
 * frames, which others read and fold meanwhile (frame_reader).
 */
class recorded_frames
{
public:
    // Throws as `recording` does.
    recorded_frames(const std::string& path,
                    const std::string& datatype,
                    const std::vector<recording::segment>& segments,
                    const preamble_folder& folder,
                    std::uint64_t frame_offset,
                    std::uint64_t header_bytes);

    // Whole frames that follow each other in the file, from frame() on; 0 at the end.
    std::uint64_t ready();
    // Index on the grid of the next frame.
    std::uint64_t frame() const { return d_walk.frame(); }
    // Passes the next frames, at most as many as are ready.
    frame_run take(std::uint64_t count);

    int symbol_length() const { return d_folder.symbol_length(); }
    // Samples of the first `count` averaged frames of a run.
    std::uint64_t span(std::uint64_t count) const
    {
        return (count - 1) * d_folder.frame_length() + d_folder.averaged_length();
    }

    // Samples that are folded at a time.
    std::uint64_t read_at_once() const;

    std::uint64_t folded() const { return d_folded; } // frames
    std::uint64_t frames_moved() const { return d_frames_moved; }
    // Frames before each slip that may lie elsewhere.
    const std::vector<frame_range>& misplaced() const { return d_misplaced; }
    // The first frame behind each retuning.
    const std::vector<std::uint64_t>& retuned() const { return d_retuned; }
    // Samples by which frame timing slipped then, each.
    const std::vector<std::uint64_t>& lost() const { return d_lost; }
    std::uint64_t samples_missing() const { return d_recording.samples_missing(); }

private:
    friend class frame_reader;

    void pass(std::uint64_t samples);
    bool start_segment();

    const preamble_folder d_folder;
    recording d_recording;
    frame_walk d_walk;
    const std::unique_ptr<mapped_part> d_watched;
    counter d_folded;
    counter d_frames_moved;
    std::vector<frame_range> d_misplaced;
    std::vector<std::uint64_t> d_lost;
    bool d_retuning = false; // before the next frame
    std::vector<std::uint64_t> d_retuned;
};

// Folds runs of frames where the file lies in memory.
class frame_reader
{
public:
    explicit frame_reader(recorded_frames& frames);

    void begin(const frame_run& run) { d_run = run; }
    // Begins with all that are ready when a run is folded; false at the end.
    bool fill();
    // The frames of the run that are not folded yet.
    const frame_run& rest() const { return d_run; }
    // Folds the next ones; returns how many. 0 at the end of the run, which is where the
    // file was cut short if that comes first.
    std::uint64_t fold(std::uint64_t most, fc32* folded, snapshot_noise* noise);
    // Of the frames last folded, those that hold samples at full scale.
    const std::vector<int>& saturated() const { return d_saturated; }

private:
    recorded_frames& d_frames;
    const std::unique_ptr<mapped_part> d_part;
    const std::uint64_t d_at_once; // frames
    frame_run d_run = {};
    std::vector<int> d_saturated;
};

} // namespace gr::wiforce::kernel
