# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce off-reflection``: estimates the switches' off state from a capture."""

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.phases.off_state import estimate_off_reflection
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.readings import RECEPTION, Flag
from gnuradio.wiforce.scene import scene_of

from ..read.recordings import read_capture
from ..shell.log import progress
from ..shell.options import capture_scene, sample_type

# Flags of groups in which the reflection is not constant.
_UNSTEADY = (RECEPTION & ~(Flag.REFERENCE | Flag.SATURATED)).words


@click.command("off-reflection")
@click.argument("capture", type=click.Path())
@capture_scene
@sample_type
def off_reflection(capture, scene_path, datatype):
    """Estimate off_reflection of every sensor from a CAPTURE with presses.

    The tag must not move. Each sensor must be pressed with several forces or at several
    locations, which need not be known but must change the phases of both ends. Prints what to
    paste into the scene's sensors, or an error if the presses do not determine it.
    """
    recording = open_capture(capture, datatype)
    scene, _ = scene_of(recording, scene_path)
    found = {}

    def on_groups(groups):
        for row, index in enumerate(groups.index.tolist()):
            found[index] = groups.phase_std_deg[row], groups.ratios[row]
        step(len(groups))

    with progress("reading", int(recording.span / scene.group_samples)) as step:
        readings = read_capture(recording, scene, frame_offset=None, on_groups=on_groups)
    for i, sensor in enumerate(scene.sensors):
        groups = [
            reading.group
            for reading in readings
            if reading.sensor == sensor.name
            and reading.touch is not None
            and not _UNSTEADY & set(reading.flags)
        ]
        values = [_of_end(found, groups, 2 * i + end, sensor, end, scene) for end in (0, 1)]
        text = ", ".join(f"[{value.real:.4f}, {value.imag:.4f}]" for value, _ in values)
        std = max(std for _, std in values)
        click.echo(f"# {sensor.name}\noff_reflection: [{text}]\noff_reflection_std: {std:.2g}")


def _of_end(found, groups, row, sensor, end, scene):
    std = np.array([found[group][0][row] for group in groups])
    ratios = np.array([found[group][1][row] for group in groups])
    untouched = sensor.load_model(scene).untouched_deg(scene.radio.center_frequency_hz)
    try:
        return estimate_off_reflection(ratios, untouched[end], std)
    except InputError as error:
        raise InputError(f"sensor '{sensor.name}', end {end + 1}", str(error)) from None
