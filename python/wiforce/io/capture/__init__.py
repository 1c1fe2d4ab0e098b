# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures: recordings of samples, and channel snapshots that another device measured."""

from .recordings import Capture, Segment, open_capture

__all__ = ["Capture", "Segment", "open_capture"]
