# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: what is measured, with what, and, for simulations, what happens."""

from .consistency import simulation_warnings
from .load import (
    accepted_suspicions,
    load_capture_scene,
    load_scene,
    sampled_scenes,
    scene_of,
    shipped_scenes,
)
from .schema import Scene, scene_json_schema
from .simulated import Press

__all__ = [
    "Press",
    "Scene",
    "accepted_suspicions",
    "load_capture_scene",
    "load_scene",
    "scene_json_schema",
    "sampled_scenes",
    "scene_of",
    "shipped_scenes",
    "simulation_warnings",
]
