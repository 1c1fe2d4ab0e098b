# SPDX-License-Identifier: GPL-3.0-or-later
"""What results depend on: stated in files of readings, and hashed to recognise stored results."""

import hashlib
import json

from gnuradio.wiforce._config import VERSION


def provenance(scene):
    """Version, scene with all defaults and sensor models by name, for the metadata of a file."""
    models = {each.name: _plain(each.load_model(scene)) for each in scene.sensors}
    return {
        "wiforce:version": VERSION,
        "wiforce:scene": json.dumps(scene.as_dict()),
        "wiforce:sensors": json.dumps(models),
    }


def fingerprint(scene, *others, simulated=False):
    """Hash of this version, a scene, its models, where simulated the true ones too, and others."""
    models = {sensor.model for sensor in scene.sensors}
    if simulated and scene.simulation:
        models |= {tag.truth_model for tag in scene.simulation.tags}
    sensors = [_plain(scene.load_model(model)) for model in sorted(models)]
    values = scene.as_dict()
    if not simulated:
        values.pop("simulation", None)
    content = json.dumps([VERSION, values, sensors, *others], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def _plain(model):
    # Loaded here, since most commands start faster without it.
    from gnuradio.wiforce.sensor.file import sensor_to_dict

    return sensor_to_dict(model)
