# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase changes of the ends: reference, average over subcarriers, profile, off state."""
