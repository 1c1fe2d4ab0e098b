// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>

namespace gr::wiforce::kernel {

// Any thread may count, and read it.
class counter
{
public:
    counter() = default;
    counter(const counter& other) : d_value(other) {}

    operator std::uint64_t() const { return d_value.load(std::memory_order_relaxed); }
    void operator+=(std::uint64_t more)
    {
        d_value.fetch_add(more, std::memory_order_relaxed);
    }

private:
    std::atomic<std::uint64_t> d_value{ 0 };
};

} // namespace gr::wiforce::kernel
