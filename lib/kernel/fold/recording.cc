// SPDX-License-Identifier: GPL-3.0-or-later
#include "recording.h"

#include "../require.h"
#include "mapped_read.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace gr::wiforce::kernel {

namespace {

constexpr const char* WHERE = "recording_source";
constexpr std::uint64_t RELEASE_STEP = 16 << 20; // bytes

[[noreturn]] void refuse(const std::string& path, const std::string& reason)
{
    throw std::invalid_argument(std::string(WHERE) + ": " + path + ' ' + reason);
}

} // namespace

recording::recording(const std::string& path,
                     std::size_t sample_bytes,
                     std::uint64_t header_bytes,
                     const std::vector<segment>& segments,
                     const preamble_folder& folder,
                     std::uint64_t frame_offset)
    : d_folder(folder),
      d_sample_bytes(sample_bytes),
      d_header_bytes(header_bytes),
      d_frame_offset(frame_offset)
{
    // Numbers in memory must be aligned.
    require(header_bytes % 4 == 0,
            WHERE,
            "header_bytes",
            "must be a multiple of 4",
            header_bytes);
    require(!segments.empty(), WHERE, "segments", "must hold one or more", "none");
    for (std::size_t n = 1; n < segments.size(); n++) {
        const segment &before = segments[n - 1], &s = segments[n];
        require(s.file_sample >= before.file_sample + before.length &&
                    s.global_index >= before.global_index + before.length,
                WHERE,
                "segments",
                "must follow each other in file and stream",
                "one that starts at " + std::to_string(s.file_sample) + ", index " +
                    std::to_string(s.global_index));
    }
    map(path);
    if (d_size < header_bytes + sample_bytes) {
        unmap();
        refuse(path, "holds no sample");
    }
    find_parts(segments);
    find_runs();
}

recording::~recording() { unmap(); }

void recording::unmap()
{
    munmap(const_cast<char*>(d_map), d_size);
    close(d_file);
}

void recording::map(const std::string& path)
{
    // A pipe without a writer must not keep us waiting.
    const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (file < 0)
        refuse(path, std::string("cannot be opened (") + std::strerror(errno) + ')');
    struct stat status;
    const bool regular = fstat(file, &status) == 0 && S_ISREG(status.st_mode);
    void* address = MAP_FAILED;
    if (regular && status.st_size > 0) {
        d_size = status.st_size;
        address = mmap(nullptr, d_size, PROT_READ, MAP_SHARED, file, 0);
    }
    const std::string reason = std::strerror(errno);
    if (address == MAP_FAILED)
        close(file);
    if (!regular)
        refuse(path, "must be a regular file");
    if (status.st_size == 0)
        refuse(path, "holds no sample");
    if (address == MAP_FAILED)
        refuse(path, "cannot be mapped (" + reason + ')');
    d_file = file;
    d_map = static_cast<const char*>(address);
    mapped_read::prepare();
    madvise(address, d_size, MADV_SEQUENTIAL);
}

void recording::find_parts(const std::vector<segment>& segments)
{
    const std::uint64_t in_file = (d_size - d_header_bytes) / d_sample_bytes;
    for (const segment& s : segments) {
        const std::uint64_t held =
            std::min(s.length, in_file - std::min(in_file, s.file_sample));
        d_samples_missing += s.length - held;
        if (held > 0)
            d_parts.push_back(
                { s.file_sample, s.global_index - segments.front().global_index, held });
    }
}

void recording::find_runs()
{
    const std::uint64_t stride = d_folder.frame_length();
    const std::uint64_t window = d_folder.averaged_length();
    const std::uint64_t first_window = d_frame_offset + d_folder.first_averaged();
    d_runs.clear();
    for (const segment& part : d_parts) {
        const std::uint64_t begin = part.global_index, end = begin + part.length;
        const std::uint64_t frame =
            begin <= first_window ? 0 : (begin - first_window + stride - 1) / stride;
        const std::uint64_t start = first_window + frame * stride;
        const std::uint64_t frames =
            end >= start + window ? 1 + (end - start - window) / stride : 0;
        if (frames > 0)
            d_runs.push_back(
                { d_header_bytes + (part.file_sample + (start - begin)) * d_sample_bytes,
                  frame,
                  frames,
                  begin,
                  end });
    }
}

void recording::lose(std::uint64_t position, std::uint64_t samples)
{
    auto part = std::find_if(d_parts.begin(), d_parts.end(), [&](const segment& p) {
        return position <= p.global_index + p.length;
    });
    const std::uint64_t before = position - part->global_index;
    const segment behind{ part->file_sample + before,
                          position + samples,
                          part->length - before };
    part->length = before;
    part = d_parts.insert(part + 1, behind);
    // Their indices count what was lost, told or not.
    for (++part; part != d_parts.end(); ++part) {
        const segment& last = *(part - 1);
        part->global_index =
            std::max(part->global_index, last.global_index + last.length);
    }
    find_runs();
}

bool recording::reaches(std::uint64_t file_byte) const
{
    struct stat status;
    return fstat(d_file, &status) == 0 &&
           static_cast<std::uint64_t>(status.st_size) >= file_byte;
}

void recording::release_before(std::uint64_t file_byte)
{
    if (file_byte < d_released + RELEASE_STEP)
        return;
    const std::uint64_t end = file_byte / RELEASE_STEP * RELEASE_STEP;
    madvise(const_cast<char*>(d_map) + d_released, end - d_released, MADV_DONTNEED);
    d_released = end;
}

} // namespace gr::wiforce::kernel
