// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "types.h"

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace gr::wiforce::kernel {

// Throws std::invalid_argument "rule, got value" unless `holds`. A rule is "where:
// parameter must ...".
template <class T>
void require(bool holds, const std::string& rule, const T& value)
{
    if (holds)
        return;
    std::ostringstream message;
    message << rule << ", got " << value;
    throw std::invalid_argument(message.str());
}

inline void require_symbol_length(int length, const std::string& where)
{
    require(length >= SHORTEST_SYMBOL && length <= LONGEST_SYMBOL,
            where + ": symbol_length must be 16 to 4096",
            length);
}

// `what`: "where: parameter".
inline void require_finite(const std::vector<complex>& values, const std::string& what)
{
    for (const complex& value : values)
        if (!std::isfinite(value.real()) || !std::isfinite(value.imag()))
            require(false, what + " must be finite", value);
}

// Gives it.
inline int require_group_length(int length)
{
    require(length >= 1, "phase_group_doppler: group_length must be >= 1", length);
    return length;
}

} // namespace gr::wiforce::kernel
