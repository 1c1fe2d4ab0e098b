# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live``: readings from a radio as they arrive; its `clients` ``status`` and ``keys``.

`run` joins the parts of a run with its outputs and requests: `session` is the flowgraph,
`radio_keeper` opens the device again after a loss, `monitor` prints the status line and warnings,
and `health` determines the state that heartbeats and systemd get.
"""
