# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models from known presses.

`tables` reads presses that a VNA or a reader measured, `data` checks and arranges them by location
and port, and `mistakes` names likely errors. `calibrate` makes a model of the curves over force
(`fit`), with its errors (`validation`), and refines it by presses over the air. `guided` measures
press by press, and `gauges` are what forces are compared with.
"""
