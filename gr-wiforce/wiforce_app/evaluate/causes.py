# SPDX-License-Identifier: GPL-3.0-or-later
"""Disturbances that explain the errors published for an experiment, one cause at a time."""

from pathlib import Path

import numpy as np
import yaml
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.scene import load_scene

FOLDER = Path(DATA_DIR) / "data" / "paper"
# The cause that the file of such a scene itself holds, in ``simulation.tags``.
OWN = "clock jitter"


def paper_figures():
    """The paper's figures by shipped scene, those of distances with their error bars."""
    figures = yaml.safe_load((FOLDER / "figures.yaml").read_text(encoding="utf-8"))
    for figure in figures.values():
        if "distance_m" in figure:
            value, error = published_phase_std(figure["distance_m"])
            figure["phase_rms_deg"], figure["error_bar"] = value, error
            bar = f"{value - error:.2f} to {value + error:.2f} deg"
            figure["text"] = f"phase std {bar} at {figure['distance_m']:g} m"
    return figures


def published_phase_std(distance_m):
    """Published standard deviation of the phase at a receiver's distance, and its error bar."""
    rows = np.genfromtxt(FOLDER / "distance_phase_std.csv", delimiter=",", names=True)
    row = rows[rows["distance_from_rx_cm"] == round(100 * distance_m)][0]
    return float(row["phase_std_deg"]), float(row["err_plus_deg"])


def other_causes(name):
    """Changes of ``simulation`` that replace a shipped scene's own disturbance, by cause."""
    found = yaml.safe_load((FOLDER / "causes.yaml").read_text(encoding="utf-8"))
    return found.get(name, {})


def with_cause(scene, change):
    """A scene with other keys of ``simulation`` and, unless they have some, ideal tags."""
    content = scene.as_dict()
    content["simulation"] |= {"tags": [], **change}
    return load_scene(content)
