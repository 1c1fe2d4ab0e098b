// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>

namespace gr::wiforce {

// Counts in its block's thread, and may be asked by any.
class counter
{
public:
    counter() = default;
    counter(const counter& other) : d_value(other) {}

    operator std::uint64_t() const { return d_value.load(std::memory_order_relaxed); }
    void operator=(std::uint64_t value)
    {
        d_value.store(value, std::memory_order_relaxed);
    }
    void operator+=(std::uint64_t more) { *this = *this + more; }

private:
    std::atomic<std::uint64_t> d_value{ 0 };
};

} // namespace gr::wiforce
