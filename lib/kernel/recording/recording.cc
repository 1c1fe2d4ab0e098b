// SPDX-License-Identifier: GPL-3.0-or-later
#include "recording.h"

#include "../require.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>

namespace gr::wiforce::kernel {

namespace {

constexpr const char* WHERE = "recording";

// Pages of 4 MB are mapped in two thirds of the time per byte that those of 256 kB take;
// more are no faster (ext4, Linux 6.18).
constexpr std::uint64_t MAPPED_BYTES = 1 << 22;

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
                     std::uint64_t header_bytes)
    : d_is_integer(is_integer(datatype)),
      d_sample_bytes(d_is_integer ? sizeof(sc16) : sizeof(fc32)),
      d_header_bytes(header_bytes),
      d_segments(segments)
{
    check_order(segments);
    open(path);
    note_end(samples_in_file());
    if (d_end == 0) {
        close(d_file);
        refuse(path, "holds no sample");
    }
    map();
}

recording::~recording()
{
    unmap();
    close(d_file);
}

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

void recording::map()
{
    if (d_header_bytes % alignof(fc32) != 0)
        return;
    d_mapped_bytes = d_header_bytes + d_end * d_sample_bytes;
    void* const mapping = mmap(nullptr, d_mapped_bytes, PROT_READ, MAP_SHARED, d_file, 0);
    if (mapping == MAP_FAILED)
        return;
    d_mapping = static_cast<char*>(mapping);
    madvise(d_mapping, d_mapped_bytes, MADV_SEQUENTIAL);
    // Where the system cannot do it once, it never can.
    piece first;
    look(0, 1, first);
    if (!let_go(first))
        unmap();
}

void recording::unmap()
{
    if (d_mapping)
        munmap(d_mapping, d_mapped_bytes);
    d_mapping = nullptr;
}

std::uint64_t recording::samples_in_file() const
{
    struct stat status;
    if (fstat(d_file, &status) != 0)
        return 0;
    const auto size = static_cast<std::uint64_t>(status.st_size);
    return (size - std::min(size, d_header_bytes)) / d_sample_bytes;
}

void recording::note_end(std::uint64_t sample) const
{
    std::uint64_t end = d_end;
    while (sample < end && !d_end.compare_exchange_weak(end, sample)) {
    }
}

std::uint64_t recording::samples_missing() const
{
    std::uint64_t missing = 0;
    for (const segment& s : d_segments) {
        const std::uint64_t before =
            d_end - std::min<std::uint64_t>(d_end, s.file_sample);
        missing += s.length - std::min(s.length, before);
    }
    return missing;
}

std::optional<std::uint64_t> recording::next_segment()
{
    for (; d_next_segment < d_segments.size(); d_next_segment++) {
        const segment& s = d_segments[d_next_segment];
        d_next_sample = s.file_sample;
        d_unread = s.length;
        if (ahead() > 0) {
            d_next_segment++;
            return s.global_index - d_segments.front().global_index;
        }
    }
    return std::nullopt;
}

std::uint64_t recording::ahead()
{
    // What is written behind the end while it is read does not count.
    const std::uint64_t end = std::min<std::uint64_t>(samples_in_file(), d_end);
    const std::uint64_t held = end - std::min(end, d_next_sample);
    if (held < d_unread) {
        d_unread = held;
        note_end(d_next_sample + held);
    }
    return d_unread;
}

std::uint64_t
recording::read(std::uint64_t sample, std::uint64_t count, char* samples) const
{
    const std::uint64_t first = d_header_bytes + sample * d_sample_bytes;
    const std::uint64_t wanted = count * d_sample_bytes;
    std::uint64_t bytes = 0;
    for (ssize_t more = 1; more > 0 && bytes < wanted;
         bytes += std::max<ssize_t>(more, 0))
        more = pread(d_file, samples + bytes, wanted - bytes, first + bytes);
    // A page that was cut meanwhile reads as zeros: the size afterwards says what counts.
    const std::uint64_t in_file = samples_in_file();
    const std::uint64_t got =
        std::min(bytes / d_sample_bytes, in_file - std::min(in_file, sample));
    if (got < count)
        note_end(sample + got);
    return got;
}

// Keeps others from writing to the file, or fails where somebody does or waits to. To
// read a page of a mapping that was cut off would end the process.
bool recording::guard() const
{
    const std::lock_guard<std::mutex> lock(d_mutex);
    if (d_guards == 0) {
        // The signal that says that somebody waits is one that is ignored unless handled.
        if (fcntl(d_file, F_SETSIG, SIGURG) != 0 ||
            fcntl(d_file, F_SETLEASE, F_RDLCK) != 0)
            return false;
    } else if (fcntl(d_file, F_GETLEASE) != F_RDLCK)
        return false;
    d_guards++;
    return true;
}

void recording::unguard() const
{
    const std::lock_guard<std::mutex> lock(d_mutex);
    if (--d_guards == 0)
        fcntl(d_file, F_SETLEASE, F_UNLCK);
}

std::uint64_t recording::look_at_once() const
{
    return (d_mapping ? MAPPED_BYTES : READ_BYTES) / d_sample_bytes;
}

std::uint64_t recording::look(std::uint64_t sample, std::uint64_t count, piece& at) const
{
    if (d_mapping && guard()) {
        const std::uint64_t in_file = samples_in_file();
        const std::uint64_t held = std::min(count, in_file - std::min(in_file, sample));
        at.samples = d_mapping + d_header_bytes + sample * d_sample_bytes;
        at.mapped_bytes = held * d_sample_bytes;
        if (held > 0 && advise(at, MADV_POPULATE_READ)) {
            if (held < count)
                note_end(sample + held);
            return held;
        }
        at.mapped_bytes = 0;
        unguard();
    }
    at.copy.resize(std::max(at.copy.size(), count * d_sample_bytes));
    at.samples = at.copy.data();
    return read(sample, count, at.copy.data());
}

bool recording::let_go(piece& at) const
{
    if (at.mapped_bytes == 0)
        return false;
    advise(at, MADV_DONTNEED); // the file's pages stay in memory, as after a read
    at.mapped_bytes = 0;
    unguard();
    return true;
}

// For all pages of a piece.
bool recording::advise(const piece& at, int advice) const
{
    const std::uint64_t first = at.samples - d_mapping;
    const std::uint64_t from = first - first % sysconf(_SC_PAGESIZE);
    return madvise(d_mapping + from, first - from + at.mapped_bytes, advice) == 0;
}

} // namespace gr::wiforce::kernel
