# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: schema, plan, channel and simulator. Numpy only."""

from .load import load_scene, shipped_scenes
from .schema import Scene

__all__ = ["Scene", "load_scene", "shipped_scenes"]
