// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "types.h"

#include <sstream>
#include <stdexcept>
#include <string>

namespace gr::wiforce::kernel {

// Throws std::invalid_argument "where: parameter rule, got value" unless `holds`.
template <class T>
void require(bool holds,
             const std::string& where,
             const std::string& parameter,
             const std::string& rule,
             const T& value)
{
    if (holds)
        return;
    std::ostringstream message;
    message << where << ": " << parameter << ' ' << rule << ", got " << value;
    throw std::invalid_argument(message.str());
}

inline void require_symbol_length(int length, const char* where)
{
    require(length >= SHORTEST_SYMBOL && length <= LONGEST_SYMBOL,
            where,
            "symbol_length",
            "must be 16 to 4096",
            length);
}

} // namespace gr::wiforce::kernel
