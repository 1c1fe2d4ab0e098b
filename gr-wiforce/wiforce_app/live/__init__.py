# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live``: readings from a radio as they arrive; its `clients` ``status`` and ``keys``.

`session` is the flowgraph of a run, `radio_keeper` opens the device again after a loss, `outputs`
gives readings and health to files and sockets, `monitor` prints the status line and warnings, and
`health` determines the state that heartbeats and systemd get.
"""
