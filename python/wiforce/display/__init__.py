# SPDX-License-Identifier: GPL-3.0-or-later
"""A live picture of readings, as a Qt widget for any program."""

from .trend import Trend
from .widget import ForceDisplay

__all__ = ["ForceDisplay", "Trend"]
