# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models: calibration from tables and press by press, transfer, off state and inversion.

`guide` opens what a guided calibration needs: readings of a live session (`live_presses`), forces
from a scale (`scales`) and answers of the operator (`operator_lines`). `dialogue` leads through it.
"""
