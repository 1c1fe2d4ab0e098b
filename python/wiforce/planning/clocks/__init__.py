# SPDX-License-Identifier: GPL-3.0-or-later
"""Switching clocks: how well some are read (`assessment`) and which are best (`proposals`).

`spacing` compares the lines of all candidates at once, `mains` keeps lines away from those of
lamps, `pulses` are the switches' waveforms, and `other_clock` avoids what a survey has found.
"""
