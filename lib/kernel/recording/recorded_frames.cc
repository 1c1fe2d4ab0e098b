// SPDX-License-Identifier: GPL-3.0-or-later
#include "recorded_frames.h"

#include "../require.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <list>
#include <mutex>

namespace gr::wiforce::kernel {

namespace {

// Frames that are folded, and looked through for limited samples, at a time.
constexpr std::uint64_t BYTES_AT_ONCE = 1 << 19;

// To map a part costs as much as to map some tens of its pages.
constexpr std::uint64_t PART_BYTES = 1 << 25;

// The handler must not allocate it, which it would in a library that is loaded late.
__attribute__((tls_model("initial-exec"))) thread_local mapped_part* looked_at = nullptr;

// What handled the signal before this file did, until the handler has given it its turn.
// The handler may run in any thread at any time and cannot wait for a lock.
std::atomic<const struct sigaction*> former{ nullptr };
static_assert(std::atomic<const struct sigaction*>::is_always_lock_free);
const struct sigaction by_default = {};

// Whoever else handles the signal takes over for other pages: the access that fails is
// made again. A handler that comes back to this one has had its turn.
void replace_page(int signal, siginfo_t* info, void*)
{
    const int error = errno;
    if (!looked_at || !looked_at->replace(info->si_addr)) {
        const struct sigaction* const before = former.exchange(nullptr);
        sigaction(signal, before ? before : &by_default, nullptr);
    }
    errno = error;
}

// Before each part, as somebody may have handled the signal since the last one.
void handle_missing_pages()
{
    static std::mutex mutex;
    // Never freed: a handler may be reading one. They are as many as somebody sets
    // others.
    static auto& known = *new std::list<struct sigaction>;
    const std::lock_guard<std::mutex> lock(mutex);
    struct sigaction action = {};
    if (sigaction(SIGBUS, nullptr, &action) != 0 || action.sa_sigaction == replace_page)
        return;
    former = &known.emplace_back(action);
    action = {};
    action.sa_sigaction = replace_page;
    action.sa_flags = SA_SIGINFO | SA_ONSTACK;
    sigaction(SIGBUS, &action, nullptr);
}

std::uint64_t page_bytes() { return sysconf(_SC_PAGESIZE); }

[[noreturn]] void refuse(const std::string& path, const std::string& reason)
{
    throw std::invalid_argument("recording: " + path + ' ' + reason);
}

bool is_integer(const std::string& datatype)
{
    require(datatype == "ci16_le" || datatype == "cf32_le",
            "recording: datatype must be 'ci16_le' or 'cf32_le'",
            "'" + datatype + "'");
    return datatype == "ci16_le";
}

void check_order(const std::vector<recording::segment>& segments)
{
    require(!segments.empty(), "recording: segments must hold one or more", "none");
    for (std::size_t n = 1; n < segments.size(); n++) {
        const auto &before = segments[n - 1], &s = segments[n];
        if (s.file_sample < before.file_sample + before.length ||
            s.global_index < before.global_index + before.length)
            require(false,
                    "recording: segments must follow each other in file and stream",
                    "one that starts at " + std::to_string(s.file_sample) + ", index " +
                        std::to_string(s.global_index));
    }
}

} // namespace

mapped_part::looking::looking(mapped_part& part) { looked_at = &part; }

mapped_part::looking::~looking() { looked_at = nullptr; }

mapped_part::~mapped_part()
{
    if (d_memory)
        munmap(d_memory, d_bytes);
}

void mapped_part::map(std::uint64_t first, std::uint64_t count)
{
    if (d_memory)
        munmap(d_memory, d_bytes);
    d_first = first - first % page_bytes();
    d_bytes = std::max(PART_BYTES, first - d_first + count);
    void* const memory = mmap(
        nullptr, d_bytes, PROT_READ, MAP_PRIVATE, d_file, static_cast<off_t>(d_first));
    d_memory = memory == MAP_FAILED ? nullptr : static_cast<char*>(memory);
    if (!d_memory)
        refuse(d_path, std::string("cannot be mapped (") + std::strerror(errno) + ')');
    madvise(d_memory, d_bytes, MADV_SEQUENTIAL);
    handle_missing_pages();
}

const char* mapped_part::at(std::uint64_t first, std::uint64_t count)
{
    if (!d_memory || first < d_first || first + count > d_first + d_bytes)
        map(first, count);
    const char* const bytes = d_memory + (first - d_first);
    if (first % alignof(float) == 0)
        return bytes;
    d_aligned.assign(bytes, bytes + count);
    return d_aligned.data();
}

bool mapped_part::replace(const void* address)
{
    const auto* const at = static_cast<const char*>(address);
    if (at < d_memory || at >= d_memory + d_bytes)
        return false;
    std::uint64_t place = at - d_memory;
    place -= place % page_bytes();
    d_unreadable = std::min<std::uint64_t>(d_unreadable, d_first + place);
    return mmap(d_memory + place,
                d_bytes - place,
                PROT_READ,
                MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED,
                -1,
                0) != MAP_FAILED;
}

recording::recording(const std::string& path,
                     const std::string& datatype,
                     const std::vector<segment>& segments,
                     std::uint64_t header_bytes)
    : d_path(path),
      d_is_integer(is_integer(datatype)),
      d_sample_bytes(d_is_integer ? sizeof(sc16) : sizeof(fc32)),
      d_header_bytes(header_bytes),
      d_segments(segments)
{
    check_order(segments);
    open();
    note_end(samples_in_file());
    if (d_end == 0) {
        close(d_file);
        refuse(path, "holds no sample");
    }
}

recording::~recording() { close(d_file); }

void recording::open()
{
    // A pipe without a writer must not keep us waiting.
    d_file = ::open(d_path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (d_file < 0)
        refuse(d_path, std::string("cannot be opened (") + std::strerror(errno) + ')');
    struct stat status;
    if (fstat(d_file, &status) != 0 || !S_ISREG(status.st_mode)) {
        close(d_file);
        refuse(d_path, "must be a regular file");
    }
    posix_fadvise(d_file, 0, 0, POSIX_FADV_SEQUENTIAL);
}

std::uint64_t recording::samples_in_file() const
{
    // Half the time of fstat, which is noticed: frames are folded in as many pieces.
    const off_t size = lseek(d_file, 0, SEEK_END);
    return size < 0 ? 0 : samples_before(size);
}

// A place in the file.
std::uint64_t recording::samples_before(std::uint64_t byte) const
{
    return (byte - std::min(byte, d_header_bytes)) / d_sample_bytes;
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

// Of samples that were looked at. A page that was cut meanwhile holds zeros: the size
// afterwards says what counts.
std::uint64_t
recording::held(std::uint64_t sample, std::uint64_t count, std::uint64_t unreadable) const
{
    const std::uint64_t end = std::min(samples_in_file(), samples_before(unreadable));
    const std::uint64_t held = std::min(count, end - std::min(end, sample));
    if (held < count)
        note_end(sample + held);
    return held;
}

recorded_frames::recorded_frames(const std::string& path,
                                 const std::string& datatype,
                                 const std::vector<recording::segment>& segments,
                                 const preamble_folder& folder,
                                 std::uint64_t frame_offset,
                                 std::uint64_t header_bytes)
    : d_folder(folder),
      d_recording(path, datatype, segments, header_bytes),
      d_walk(folder, frame_offset),
      d_watched(d_recording.part())
{
}

std::uint64_t recorded_frames::ready()
{
    while (true) {
        pass(std::min({ d_recording.ahead(), d_walk.until_decision(), d_walk.lead() }));
        const std::uint64_t whole =
            d_walk.whole_frames(std::min(d_recording.ahead(), d_walk.until_decision()));
        if (whole > 0)
            return whole;
        if (d_walk.decision_is_due()) {
            if (const std::uint64_t lost = d_walk.decide()) {
                d_frames_moved += 1;
                d_misplaced.push_back(d_walk.misplaced());
                d_lost.push_back(lost);
            }
        } else if (!start_segment())
            return 0;
    }
}

frame_run recorded_frames::take(std::uint64_t count)
{
    if (d_retuning)
        d_retuned.push_back(frame());
    d_retuning = false;
    const frame_run run = { d_recording.sample() + d_walk.lead(), frame(), count };
    pass(d_walk.span(count));
    return run;
}

void recorded_frames::pass(std::uint64_t samples)
{
    const std::uint64_t unwatched = std::min(samples, d_walk.until_watched());
    d_walk.pass_unwatched(unwatched);
    d_recording.pass(unwatched);
    const std::uint64_t watched = samples - unwatched;
    if (watched == 0)
        return;
    const std::uint64_t held =
        d_recording.look(*d_watched, d_recording.sample(), watched, [&](const auto* in) {
            d_walk.pass(in, watched);
        });
    if (held < watched)
        d_walk.skip(0); // forgets the zeros
    d_recording.pass(watched);
}

bool recorded_frames::start_segment()
{
    d_walk.skip(d_recording.ahead());
    const auto start = d_recording.next_segment();
    if (!start)
        return false;
    d_retuning |= d_recording.is_retuned();
    // A segment's index counts the samples lost before it, those of a slip included.
    d_walk.skip(std::max(*start, d_walk.position()) - d_walk.position());
    return true;
}

std::uint64_t recorded_frames::read_at_once() const
{
    return BYTES_AT_ONCE / d_recording.sample_bytes();
}

frame_reader::frame_reader(recorded_frames& frames)
    : d_frames(frames),
      d_part(frames.d_recording.part()),
      d_at_once(std::max<std::uint64_t>(
          frames.read_at_once() / frames.d_folder.frame_length(), 1))
{
}

bool frame_reader::fill()
{
    if (d_run.count == 0)
        if (const std::uint64_t ready = d_frames.ready())
            d_run = d_frames.take(ready);
    return d_run.count > 0;
}

std::uint64_t frame_reader::fold(std::uint64_t most, fc32* folded, snapshot_noise* noise)
{
    std::uint64_t count = std::min({ most, d_run.count, d_at_once });
    while (count > 0) {
        const std::uint64_t wanted = d_frames.span(count);
        const std::uint64_t held = d_frames.d_recording.look(
            *d_part, d_run.sample, wanted, [&](const auto* samples) {
                d_frames.d_folder.fold(samples, count, folded, noise, d_saturated);
            });
        if (held == wanted)
            break;
        // The file was cut short: those that are whole are folded again, by themselves.
        while (count > 0 && d_frames.span(count) > held)
            count--;
        d_run.count = count;
    }
    if (count == 0)
        d_saturated.clear(); // of frames that were cut off while they were folded
    d_run.sample += count * d_frames.d_folder.frame_length();
    d_run.frame += count;
    d_run.count -= count;
    d_frames.d_folded += count;
    return count;
}

} // namespace gr::wiforce::kernel
