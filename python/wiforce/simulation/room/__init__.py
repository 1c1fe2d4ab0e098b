# SPDX-License-Identifier: GPL-3.0-or-later
"""The room of a simulated scene: static and moving paths, lamps, people, other transmitters."""
