# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided calibrations: what is asked for and what is stored.

`press_measurement` measures a press; `session` checks each of them and keeps all, with their plan,
in a file.
"""
