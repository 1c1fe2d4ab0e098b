# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios: their drivers, what these have in common (`radio`), and the process that uses a device.

The reader opens a device through a `RadioLink` of `link`, which starts that process.
"""
