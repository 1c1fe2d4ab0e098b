# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmitter and receiver of a simulated scene: analogue parts, oscillators, converter."""
