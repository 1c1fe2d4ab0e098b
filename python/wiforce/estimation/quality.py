# SPDX-License-Identifier: GPL-3.0-or-later
"""Doubt from which on a reading is flagged ``weak``, as documented in docs/sensors.md."""

# Standard deviations of a phase and of the force.
WEAK_PHASE_DEG = 3.0
WEAK_FORCE_N = 1.5
