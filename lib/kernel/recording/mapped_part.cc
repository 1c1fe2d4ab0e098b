// SPDX-License-Identifier: GPL-3.0-or-later
#include "mapped_part.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <mutex>
#include <stdexcept>

namespace gr::wiforce::kernel {

namespace {

// To map a part costs as much as to map some tens of its pages.
constexpr std::uint64_t PART_BYTES = 1 << 25;

// The handler must not allocate it, which it would in a library that is loaded late.
__attribute__((tls_model("initial-exec"))) thread_local mapped_part* looked_at = nullptr;

struct sigaction former;

// Whoever else handles the signal takes over for other pages: the access that fails is
// made again. A handler that comes back to this one has had its turn.
void replace_page(int signal, siginfo_t* info, void*)
{
    const int error = errno;
    const bool is_sent = info->si_code <= 0; // by a process, without an access
    if (is_sent || !looked_at || !looked_at->replace(info->si_addr)) {
        sigaction(signal, &former, nullptr);
        former = {};
        if (is_sent)
            raise(signal);
    }
    errno = error;
}

// Before each part, as somebody may have handled the signal since the last one.
void handle_missing_pages()
{
    static std::mutex mutex;
    const std::lock_guard<std::mutex> lock(mutex);
    struct sigaction action = {};
    if (sigaction(SIGBUS, nullptr, &action) != 0 || action.sa_sigaction == replace_page)
        return;
    former = action;
    action = {};
    action.sa_sigaction = replace_page;
    action.sa_flags = SA_SIGINFO | SA_ONSTACK;
    sigaction(SIGBUS, &action, nullptr);
}

std::uint64_t page_bytes() { return sysconf(_SC_PAGESIZE); }

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
    if (memory == MAP_FAILED) {
        const std::string reason = std::strerror(errno);
        d_memory = nullptr;
        throw std::invalid_argument("recording: " + d_path + " cannot be mapped (" +
                                    reason + ')');
    }
    d_memory = static_cast<char*>(memory);
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

} // namespace gr::wiforce::kernel
