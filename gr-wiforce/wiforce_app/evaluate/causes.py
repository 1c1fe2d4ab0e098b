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


def published_phase_std(distance_m=None):
    """Published standard deviation of the phase, in degrees, and its error bar.

    ``distance_m``: from the receiver; all distances, as an array with named columns, without it.
    """
    rows = np.genfromtxt(FOLDER / "distance_phase_std.csv", delimiter=",", names=True)
    if distance_m is None:
        return rows
    row = rows[rows["distance_from_rx_cm"] == round(100 * distance_m)][0]
    return float(row["phase_std_deg"]), float(row["err_plus_deg"])


def other_causes(name):
    """Changes of ``simulation`` that replace a scene's own disturbance, by cause.

    ``name``: of a shipped scene; any other name has none.
    """
    found = yaml.safe_load((FOLDER / "causes.yaml").read_text(encoding="utf-8"))
    return found.get(name, {})


def with_cause(scene, change):
    """A scene with another disturbance instead of its own.

    ``change``: keys of ``simulation``. Without ``tags``, the tags are ideal.
    """
    content = scene.as_dict()
    content["simulation"] |= {"tags": [], **change}
    return load_scene(content)
