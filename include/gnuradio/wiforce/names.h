// SPDX-License-Identifier: GPL-3.0-or-later
// Names of stream tags, message ports and message keys. blocks/names.py holds the same
// names, which a test checks.
#pragma once

namespace gr::wiforce::names {

// Stream tags
constexpr char RX_TIME[] = "rx_time";
constexpr char RX_RATE[] = "rx_rate";
constexpr char RX_FREQ[] = "rx_freq";
constexpr char SNAPSHOT[] = "snapshot";
constexpr char NOISE[] = "noise";
constexpr char GROUP[] = "group";
constexpr char MISSING[] = "missing";
constexpr char REJECTED[] = "rejected";
constexpr char DISTURBED[] = "disturbed";
constexpr char SATURATED[] = "saturated";
constexpr char RETUNED[] = "retuned";
constexpr char SLIPPED[] = "slipped";
constexpr char STATIC[] = "static";
constexpr char STATE[] = "state";
constexpr char MASK[] = "mask"; // also a key of the PDUs on the port "incomplete"

// Message ports
constexpr char INCOMPLETE[] = "incomplete";
constexpr char READINGS[] = "readings";
constexpr char TARE[] = "tare";
constexpr char TARE_STATE[] = "tare_state";
constexpr char WARNINGS[] = "warnings";

// Keys of the dicts on the port "tare"
constexpr char FORCE[] = "force";

// Key of the dicts on the port "warnings"
constexpr char TEXT[] = "text";

} // namespace gr::wiforce::names
