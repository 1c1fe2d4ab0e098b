# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of stream tags, message ports and message keys; names.h says the same."""

# Stream tags
RX_TIME = "rx_time"
RX_RATE = "rx_rate"
RX_FREQ = "rx_freq"
SNAPSHOT = "snapshot"
NOISE = "noise"
GROUP = "group"
MISSING = "missing"
REJECTED = "rejected"
DISTURBED = "disturbed"
SATURATED = "saturated"
RETUNED = "retuned"
SLIPPED = "slipped"
STATIC = "static"
STATE = "state"
MASK = "mask"  # also a key of the PDUs on the port "incomplete", with GROUP

# Message ports
INCOMPLETE = "incomplete"
READINGS = "readings"
TARE = "tare"
TARE_STATE = "tare_state"
WARNINGS = "warnings"

# Keys of the dicts on the port "tare"
FORCE = "force"

# Key of the dicts on the port "warnings"
TEXT = "text"
