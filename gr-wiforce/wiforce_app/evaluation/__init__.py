# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as experiments: simulated, read by this receiver and by the paper's method, scored."""
