# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided calibrations: what is asked for and what is stored.

`press_measurement` measures a press, `entry_plausibility` says whether it can be true, and
`session` keeps all of them, with their plan, in a file.
"""
