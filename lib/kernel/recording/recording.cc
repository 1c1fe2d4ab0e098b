// SPDX-License-Identifier: GPL-3.0-or-later
#include "recording.h"

#include "../require.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace gr::wiforce::kernel {

namespace {

constexpr const char* WHERE = "recording";
// A read of half a megabyte costs little more than its copy, and leaves the samples in
// the second cache. Guards are read as well: leaving them out takes a call per frame,
// which doubles the time (frames of 720 samples, page cache).
constexpr std::uint64_t READ_BYTES = 1 << 19;

[[noreturn]] void refuse(const std::string& path, const std::string& reason)
{
    throw std::invalid_argument(std::string(WHERE) + ": " + path + ' ' + reason);
}

bool is_integer(const std::string& datatype)
{
    require(datatype == "ci16_le" || datatype == "cf32_le",
            WHERE,
            "datatype",
            "must be 'ci16_le' or 'cf32_le'",
            "'" + datatype + "'");
    return datatype == "ci16_le";
}

void check_order(const std::vector<recording::segment>& segments)
{
    require(!segments.empty(), WHERE, "segments", "must hold one or more", "none");
    for (std::size_t n = 1; n < segments.size(); n++) {
        const auto &before = segments[n - 1], &s = segments[n];
        require(s.file_sample >= before.file_sample + before.length &&
                    s.global_index >= before.global_index + before.length,
                WHERE,
                "segments",
                "must follow each other in file and stream",
                "one that starts at " + std::to_string(s.file_sample) + ", index " +
                    std::to_string(s.global_index));
    }
}

} // namespace

recording::recording(const std::string& path,
                     const std::string& datatype,
                     const std::vector<segment>& segments,
                     std::uint64_t header_bytes,
                     std::uint64_t held_samples)
    : d_is_integer(is_integer(datatype)),
      d_sample_bytes(d_is_integer ? sizeof(sc16) : sizeof(fc32)),
      d_header_bytes(header_bytes)
{
    check_order(segments);
    open(path);
    if (samples_in_file() == 0) {
        close(d_file);
        refuse(path, "holds no sample");
    }
    clip(segments);
    d_buffer.resize(READ_BYTES + held_samples * d_sample_bytes);
}

recording::~recording() { close(d_file); }

void recording::open(const std::string& path)
{
    // A pipe without a writer must not keep us waiting.
    d_file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (d_file < 0)
        refuse(path, std::string("cannot be opened (") + std::strerror(errno) + ')');
    struct stat status;
    if (fstat(d_file, &status) != 0 || !S_ISREG(status.st_mode)) {
        close(d_file);
        refuse(path, "must be a regular file");
    }
    posix_fadvise(d_file, 0, 0, POSIX_FADV_SEQUENTIAL);
}

std::uint64_t recording::samples_in_file() const
{
    struct stat status;
    if (fstat(d_file, &status) != 0)
        return 0;
    const auto size = static_cast<std::uint64_t>(status.st_size);
    return (size - std::min(size, d_header_bytes)) / d_sample_bytes;
}

void recording::clip(const std::vector<segment>& segments)
{
    const std::uint64_t in_file = samples_in_file();
    for (const segment& s : segments) {
        const std::uint64_t length =
            std::min(s.length, in_file - std::min(in_file, s.file_sample));
        d_samples_missing += s.length - length;
        if (length > 0)
            d_segments.push_back({ s.file_sample,
                                   s.global_index - segments.front().global_index,
                                   length });
    }
}

std::optional<std::uint64_t> recording::next_segment()
{
    if (d_next_segment == d_segments.size())
        return std::nullopt;
    const segment& s = d_segments[d_next_segment++];
    d_next_sample = s.file_sample;
    d_unread = s.length;
    d_held = 0;
    return s.global_index;
}

void recording::drop(std::uint64_t samples)
{
    d_first += samples;
    d_held -= samples;
}

bool recording::read_on()
{
    if (d_unread == 0)
        return false;
    char* const buffer = d_buffer.data();
    std::memmove(buffer, buffer + d_first * d_sample_bytes, d_held * d_sample_bytes);
    d_first = 0;
    const std::uint64_t wanted =
        std::min(d_unread, d_buffer.size() / d_sample_bytes - d_held);
    const ssize_t bytes = pread(d_file,
                                buffer + d_held * d_sample_bytes,
                                wanted * d_sample_bytes,
                                d_header_bytes + d_next_sample * d_sample_bytes);
    // A page that was cut meanwhile reads as zeros: the size afterwards says what counts.
    const std::uint64_t in_file = samples_in_file();
    const std::uint64_t got =
        std::min<std::uint64_t>(std::max<ssize_t>(bytes, 0) / d_sample_bytes,
                                in_file - std::min(in_file, d_next_sample));
    d_held += got;
    d_next_sample += got;
    d_unread -= got;
    if (got == 0) {
        d_samples_missing += d_unread;
        d_unread = 0;
    }
    return got > 0;
}

} // namespace gr::wiforce::kernel
