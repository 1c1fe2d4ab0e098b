# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrations: of surfaces, with a person at the sensor, and the picture of the result."""
