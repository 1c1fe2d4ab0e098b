# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensors: models, calibration, inversion, the physical line. Numpy only."""
