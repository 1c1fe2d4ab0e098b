# SPDX-License-Identifier: GPL-3.0-or-later
"""Live pictures of readings as Qt widgets, for use in any program."""

# First of all: pyqtgraph uses the Qt that is loaded already, and must not choose another.
from PyQt5 import QtCore  # noqa: F401

from .plots import Spectrum, Trend
from .widget import ForceDisplay

__all__ = ["ForceDisplay", "Spectrum", "Trend"]
