// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * A part of a file in memory, as one thread at a time looks at it.
 *
 * Where the file was cut off meanwhile, or cannot be read, there are zeros: the signal
 * (SIGBUS) that would end the process is handled for the thread that looks.
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

} // namespace gr::wiforce::kernel
