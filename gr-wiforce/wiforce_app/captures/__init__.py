# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: opened and read for every command, one, many in parallel, or while they grow."""
