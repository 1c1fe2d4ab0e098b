# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses of a simulated scene: force over time, what the line shows, and a skin over strips."""
