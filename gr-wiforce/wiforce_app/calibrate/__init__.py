# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models: calibration from tables and press by press, transfer, off state and inversion.

`guide` opens what a guided calibration needs: readings of a live session, forces from a scale and
answers of the operator. `dialogue` leads through it.
"""
