# SPDX-License-Identifier: GPL-3.0-or-later
"""What sections of a scene must not say against each other."""

from ..errors import InputError


def check_scene(top, scene):
    """Refuses a scene whose clocks, times, models and presses do not go together.

    Parameters
    ----------
    top : yamlfile.Section
        For the name of the file in messages.
    scene : Scene

    Raises
    ------
    InputError
    """
    _check_clocks_apart(top, scene)
    _check_duration(top, scene)
    _check_presses(top, scene, _checked_models(top, scene))


def _check_clocks_apart(top, scene):
    """No line on which one tag is read may lie on a main line of another tag."""
    resolution_hz = 1 / scene.group_period_s
    for i, second in enumerate(scene.sensors):
        for first in scene.sensors[:i]:
            for a, b in ((1, 1), (2, 1), (4, 1), (1, 2), (1, 4)):
                lines = a * first.clock_hz, b * second.clock_hz
                wander = 1e-6 * sum(
                    line * sensor.clock_tolerance_ppm
                    for line, sensor in zip(lines, (first, second), strict=True)
                )
                apart = max(resolution_hz, wander)
                if abs(lines[0] - lines[1]) < apart:
                    rule = (
                        f"{b} x clock_hz must lie {apart:.3g} Hz or more from {a} x the clock of "
                        f"sensor '{first.name}' ({first.clock_hz:g})"
                    )
                    raise top.error(f"sensors[{i}].clock_hz", rule, second.clock_hz)


def _check_duration(top, scene):
    duration_s = scene.simulation.duration_s
    if duration_s < scene.group_period_s:
        rule = f"must hold at least one phase group ({scene.group_period_s:.6g} s)"
        raise top.error("simulation.duration_s", rule, duration_s)
    for i, press in enumerate(scene.simulation.presses):
        if press.start_s >= duration_s:
            rule = f"must begin before simulation.duration_s ({duration_s:g})"
            raise top.error(f"simulation.presses[{i}].start_s", rule, press.start_s)


def _checked_models(top, scene):
    """Every model by the name the scene gives it; each must be there and hold the carrier."""
    keys = {sensor.model: f"sensors[{i}].model" for i, sensor in enumerate(scene.sensors)}
    for tag in scene.simulation.tags:
        keys.setdefault(tag.truth_model, "simulation: truth_model")
    models = {}
    for name, key in keys.items():
        try:
            models[name] = scene.load_model(name)
        except InputError as error:
            raise top.error(key, str(error).removeprefix("sensor: ")) from None
        try:
            models[name].carrier_index(scene.radio.center_frequency_hz)
        except InputError as error:
            raise top.error("radio.center_frequency_hz", f"model {error}") from None
    return models


def _check_presses(top, scene, models):
    """Locations must lie on the pressed line; its length is the truth model's."""
    truths = {tag.sensor: models[tag.truth_model] for tag in scene.simulation.tags}
    for i, press in enumerate(scene.simulation.presses):
        length_mm = truths[press.sensor].length_mm
        if press.location_mm > length_mm:
            rule = f"must lie on the line, 0 to {length_mm:g} mm"
            raise top.error(f"simulation.presses[{i}].location_mm", rule, press.location_mm)
