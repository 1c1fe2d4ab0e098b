# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: schema, plan, channel and simulator. Numpy only."""

from .schema import Scene, load_scene, shipped_scenes

__all__ = ["Scene", "load_scene", "shipped_scenes"]
