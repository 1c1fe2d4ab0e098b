// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

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

} // namespace gr::wiforce::kernel
