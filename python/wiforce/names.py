# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of stream tags, message ports and message keys; names.h says the same."""

# Stream tags
RX_TIME = "rx_time"
SNAPSHOT = "snapshot"
GROUP = "group"
MISSING = "missing"
SATURATED = "saturated"
STATE = "state"

# Message ports
INCOMPLETE = "incomplete"
READINGS = "readings"
TARE = "tare"

# Keys of the PDUs on the port "incomplete" (with GROUP)
MASK = "mask"
