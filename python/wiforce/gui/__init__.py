# SPDX-License-Identifier: GPL-3.0-or-later
"""A live picture of readings, as a Qt widget for any program."""

# First of all: pyqtgraph draws with the Qt that is there already, and must not choose another.
from PyQt5 import QtCore  # noqa: F401

from .trend import Trend
from .widget import ForceDisplay

__all__ = ["ForceDisplay", "Trend"]
