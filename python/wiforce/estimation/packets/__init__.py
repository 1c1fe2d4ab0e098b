# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets of a card: channels free of its oscillator and receiver chains, and their groups."""
