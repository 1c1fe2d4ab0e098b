# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: schema, plan, channel and simulator. Numpy only."""
