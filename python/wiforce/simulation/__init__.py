# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: paths, tags and front end at sample level.

`simulator` writes a scene's capture and its truth. `channel` is the channel at sample level: the
`paths` of the room, the `tag`s with their `presses`, and the `radio`. `packets` gives channel
snapshots instead of samples, and `truth` compares readings with what was applied.

The estimator uses nothing from here. The simulator shares with it only the definition of the
sounding frame.
"""
