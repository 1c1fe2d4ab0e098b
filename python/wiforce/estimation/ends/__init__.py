# SPDX-License-Identifier: GPL-3.0-or-later
"""Channels of the tags' ends, separated from a group's tones, with their noise."""
