# SPDX-License-Identifier: GPL-3.0-or-later
"""What simulated captures of both kinds have in common: groups, truth, and whole files."""

import csv
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..io.readings import rounded
from ..scene import Scene
from .presses.skin import surface_truth

TRUTH_COLUMNS = (
    "time_s", "sensor", "touch", "force_n", "location_mm", "phase1_deg", "phase2_deg",
)  # fmt: skip


def frame_count(scene: Scene) -> int:
    """Number of whole sounding frames in the scene's duration."""
    return int(scene.simulation.duration_s / scene.snapshot_period_s + 1e-9)


def group_centers(scene: Scene) -> np.ndarray:
    """Centres of the whole phase groups of a scene's capture.

    Returns ndarray of float, shape (groups,): in s from the first sample.
    """
    if scene.packets:
        groups = int(scene.simulation.duration_s / scene.group_period_s + 1e-9)
        return (np.arange(groups) + 0.5) * scene.group_period_s
    groups = frame_count(scene) // scene.phase_group.snapshots
    return (np.arange(groups) + 0.5) * scene.group_samples / scene.radio.sample_rate_hz


def write_truth(scene: Scene, channel: Any, path: str | Path) -> None:
    """Write the state at the centre of each phase group as CSV, a row per group and sensor.

    ``force_n`` is the force on the sensor even where it is too small to short the line (``touch``
    0); ``location_mm`` is empty where nothing presses. A surface has rows of its own, with x in
    ``location_mm`` and y in one more column. Numbers are rounded as those of readings.

    Parameters
    ----------
    channel : AirChannel or SimulatedPackets
        That of the scene.
    """
    times = group_centers(scene)
    states = channel.touch_state(times)
    of_surface = surface_truth(scene, times)
    also = () if scene.surface is None else ("y_mm",)
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow((*TRUTH_COLUMNS, *also))
        for i, time_s in enumerate(times.tolist()):
            for name, state in states.items():
                numbers = (state.force_n[i], state.location_mm[i], *state.phases_deg[i])
                writer.writerow(
                    [
                        rounded("time_s", time_s),
                        name,
                        int(state.touch[i]),
                        *map(rounded, TRUTH_COLUMNS[3:], numbers),
                        *("" for _ in also),
                    ]
                )
            for row in of_surface[i]:
                cells = [row.get(name, "") for name in (*TRUTH_COLUMNS[1:], *also)]
                cells = [round(x, 4) if isinstance(x, float) else x for x in cells]
                writer.writerow([rounded("time_s", time_s), *cells])


@contextmanager
def all_or_nothing(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Files that appear together when all of them are complete, or not at all.

    Yields list of Path: to write to: they are in a temporary folder beside ``paths``, and moved
    there in order after success.

    Parameters
    ----------
    paths : sequence of Path
        In one folder.
    """
    with tempfile.TemporaryDirectory(prefix=".simulate-", dir=paths[0].parent) as folder:
        temporary = [Path(folder) / path.name for path in paths]
        yield temporary
        for source, target in zip(temporary, paths, strict=True):
            os.replace(source, target)
