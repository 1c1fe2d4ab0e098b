# SPDX-License-Identifier: GPL-3.0-or-later
"""Tags of a simulated scene: their clocks and switches, and the hand near them."""
