# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: paths, tags and front end at sample level.

The estimator uses nothing from here. The simulator shares with it only the definition of the
sounding frame.
"""
