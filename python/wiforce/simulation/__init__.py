# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: paths, tags and front end at sample level.

`simulator` writes a scene's capture and its truth. `channel` is the channel at sample level: the
paths of the `room`, the `tags` with their `presses`, and the `radio`. `packets` gives channel
snapshots instead of samples, and `score` compares readings with the truth.

The estimator uses nothing from here. The simulator shares with it only the definition of the
sounding frame.
"""
