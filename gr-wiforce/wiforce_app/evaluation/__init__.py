# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as experiments: simulated, read by us and by the paper's method, scored, reported."""
