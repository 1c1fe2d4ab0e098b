# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios: their drivers, the process that uses a device, and the reader's link to it.

A driver may abort, hang or refuse when a device disappears, so another process than the reader
uses it (`process.py`, started by `link.py`). `radio.py` is what drivers have in common.
"""
