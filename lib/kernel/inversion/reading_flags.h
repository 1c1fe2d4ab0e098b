// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

namespace gr::wiforce::kernel {

//! What is to be known about an inverted reading; a reading may have several.
enum reading_flag : std::uint8_t {
    ambiguous = 1,          //!< another press would show the same phases
    force_unobservable = 2, //!< force and location cannot be distinguished
    inconsistent = 4,       //!< no single press shows such phases
    extrapolated = 8        //!< outside what was calibrated
};

} // namespace gr::wiforce::kernel
