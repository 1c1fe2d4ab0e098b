# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models from known presses.

`tables` reads presses that a VNA or a reader measured, `checks` rejects tables with errors, and
`mistakes` names likely ones. `calibrate` makes a model: from `data` by location and port, curves
over force (`fit`), a model per carrier (`carrier_fit`) and its errors (`validation`, `verdict`).
`refine` improves a model by presses over the air, and `guided` measures press by press.
"""
