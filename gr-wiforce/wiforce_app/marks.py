# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks of stored results: hashes of everything that a result depends on."""

import hashlib
import json

from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.sensor.file import sensor_to_dict


def mark_of(scene, *others, simulated=False):
    """Hash of this version, a scene, the models of its sensors and what else is given.

    Parameters
    ----------
    scene : Scene
    others : JSON values
    simulated : bool
        The result depends on the truth models of the scene's tags as well.

    Returns
    -------
    str
    """
    models = {sensor.model for sensor in scene.sensors}
    if simulated and scene.simulation:
        models |= {tag.truth_model for tag in scene.simulation.tags}
    sensors = [sensor_to_dict(scene.load_model(model)) for model in sorted(models)]
    values = scene.as_dict()
    if not simulated:
        values.pop("simulation", None)
    content = json.dumps([VERSION, values, sensors, *others], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
