# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models from known presses.

`tables` reads presses that a VNA or a reader measured, `data` checks and arranges them by location
and port, and `mistakes` and `wrong_entries` name likely errors. `calibrate` makes a model of the
curves over force (`fit`), with its errors (`validation`), and refines it by presses over the air. A
`session` measures press by press. `gauges` read what measures forces, and `gauge_comparison`
compares readings with it.
"""
