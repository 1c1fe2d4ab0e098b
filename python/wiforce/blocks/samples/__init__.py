# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks on streams of samples: from captures, other processes and simulated tags, and to files."""
