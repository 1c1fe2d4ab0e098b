# SPDX-License-Identifier: GPL-3.0-or-later
"""What the host talks to: sockets, slow and fast control, registers and EEPROMs."""
