# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of the display."""

from PyQt5.QtGui import QColor

# One per sensor; those who see red and green alike can tell them apart too (Okabe and Ito).
SENSORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
INK, FAINT, PAPER, DOUBT = map(QColor, ("#202428", "#737a82", "#ffffff", "#b45f00"))
BEAM, GROUND = map(QColor, ("#cdd4db", "#9aa3ac"))
