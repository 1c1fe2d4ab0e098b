# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks of the tags: found, followed, and the shape of their pulses."""
