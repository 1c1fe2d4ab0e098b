# SPDX-License-Identifier: GPL-3.0-or-later
"""Survey of the room: what the spectrum of the snapshots holds besides the tags' lines."""
