# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided calibrations: what is asked for and what is stored.

`session_plan` lists the presses, `press_measurement` measures one, `entry_plausibility` says
whether it can be true, and `session` keeps all of them in a file (`session_file`).
"""
