# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks of the receiver, a step each, for flowgraphs that show what happens in between."""
