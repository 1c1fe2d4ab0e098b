# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce survey``: what else is in the room of a capture."""

import json
from functools import partial

import click
import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.palette import FAINT, INK, MARKERS, SERIES
from gnuradio.wiforce.receiver.captures import survey_room
from gnuradio.wiforce.scene import scene_of
from gnuradio.wiforce.signal.lines import aliased_hz

from ..read.recordings import warn
from ..shell.commands import GroupedHelp
from ..shell.options import capture_scene, refuse_scenes, sample_type
from ..shell.plots import check_picture, legend_below, save_picture

# The first two are of the tags and of what the weights reject.
_FOUND = SERIES[2:]
_LOWEST_DB = -6.0
# Lines are marked where they stand out by so many dB.
_STANDS_OUT_DB = 3.0
# Half width of a line in the spectrum, in bins.
_REACH = 5


def plot_survey(survey, found, plan, path, title):
    """Plot a survey's spectrum with the tags' lines and all that was found."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 6), layout="constrained")
    axis = canvas.subplots()
    hertz, level = survey.frequency_hz, _level_db(survey)
    name = "spectrum of the untouched reference"
    axis.plot(hertz / 1e3, level, lw=0.7, color=FAINT, label=name)
    axis.axhline(0, color=INK, lw=1.0, ls="--", label="noise floor")
    if plan.clutter_hz:
        name = f"rejected by the weights, 0 to {plan.clutter_hz:.0f} Hz"
        axis.axvspan(0, plan.clutter_hz / 1e3, color=SERIES[1], alpha=0.25, lw=0, label=name)
    names = plan.require_scene().sensor_names
    for index, (name, clock) in enumerate(zip(names, plan.clocks, strict=True)):
        lines = [m * clock.clock_hz for m in range(1, plan.harmonics + 1)]
        style = {"color": SERIES[0], "marker": MARKERS[index % len(MARKERS)]}
        _mark(axis, survey, lines, label=f"lines of '{name}' ({clock.clock_hz:g} Hz)", **style)
    for index, finding in enumerate(found):
        color = _FOUND[index % len(_FOUND)]
        label = f"{finding.name}, {finding.level_db:+.1f} dB"
        if finding.kind == "clutter":
            axis.axvline(finding.frequency_hz / 1e3, lw=1.2, color=color, label=label)
        else:
            style = {"color": color, "marker": MARKERS[index % len(MARKERS)]}
            _mark(axis, survey, finding.lines_hz, label=label, **style)
    axis.set_xlim(0, hertz[-1] / 1e3)
    axis.set_ylim(_LOWEST_DB, level.max() + 5)
    axis.grid(alpha=0.3)
    axis.set_xlabel("frequency (kHz)")
    axis.set_ylabel("power above the noise floor (dB)")
    axis.set_title(title, fontsize=11)
    legend_below(canvas, *axis.get_legend_handles_labels(), ncols=2)
    save_picture(canvas, path)


def _level_db(survey):
    return 10 * np.log10(np.maximum(survey.spectrum, 1e-3))


def _mark(axis, survey, lines_hz, **style):
    """Mark lines just above the spectrum."""
    rate, step_hz = 1 / survey.snapshot_period_s, survey.frequency_hz[1]
    level, marks = _level_db(survey), []
    for hertz in lines_hz:
        seen = abs(aliased_hz(hertz, rate))
        middle = int(round(seen / step_hz))
        top = level[max(0, middle - _REACH) : middle + _REACH + 1].max()
        if top > _STANDS_OUT_DB:
            marks.append((seen / 1e3, top + 1.5))
    axis.plot(*np.reshape(marks, (-1, 2)).T, ls="", ms=6, **style)


@click.command(cls=GroupedHelp, examples=("survey press --plot room.png",))
@click.argument("capture", type=click.Path())
@capture_scene
@sample_type
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a picture of the spectrum with all that was found (PNG, PDF or SVG).",
)
def survey(capture, scene_path, datatype, as_json, plot_path):
    """Show what is in the room: movers, lamps, other tags, and what is done about them.

    The spectrum is that of the untouched reference at the start of the CAPTURE.
    """
    refuse_scenes([capture])
    recording = open_capture(capture, datatype)
    scene, differences = scene_of(recording, scene_path)
    check_picture(plot_path, [*recording.files, *scene.files])
    found = survey_room(recording, scene, differences, partial(warn, recording.path))
    if plot_path is not None:
        plot_survey(found.survey, found.findings, found.plan, plot_path, str(capture))
    click.echo(json.dumps(found.report(), indent=2) if as_json else str(found))
