# SPDX-License-Identifier: GPL-3.0-or-later
"""A software USRP N210: the device's side of the protocol of libuhd's ``usrp2`` driver.

``gr-wiforce emulate`` runs one; docs/radios.md describes it. `device` is the loop, `hardware` what
it moves: registers, the streams (`receive`, `transmit`), and what is between the connectors
(`frontend`, `scene_air`). `host_link` is the host's side.
"""
