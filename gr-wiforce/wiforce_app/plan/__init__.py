# SPDX-License-Identifier: GPL-3.0-or-later
"""Before a measurement: the plan of a scene, the survey of a room, checks of radio and captures."""
