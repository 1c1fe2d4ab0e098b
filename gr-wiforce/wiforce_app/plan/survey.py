# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce survey``: what else is in the room of a capture."""

import json

import click
import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.palette import FAINT, INK, SERIES
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.captures import survey_room
from gnuradio.wiforce.scene import scene_of
from gnuradio.wiforce.signal.lines import aliased_hz

from ..read.recordings import warn
from ..shell.commands import GroupedHelp
from ..shell.options import capture_scene, refuse_scenes, sample_type
from ..shell.plots import check_picture, legend_below, save_picture

_MARKERS = "ovsDP*Xd"
# The first two are of the tags and of what the weights reject.
_FOUND = SERIES[2:]
_OWN_MARKERS = "^v<>"
_LOWEST_DB = -6.0
# Lines of the scene's tags are drawn where more than this part of the floor is expected, and lines
# are marked where they stand out by so many dB.
_VISIBLE, _STANDS_OUT_DB = 0.3, 3.0
# Lines of a real tag may be so much stronger than those of ideal switches.
_STRONGER = 4.0
# Half width of a line in the spectrum, in bins.
_REACH = 5


def plot_survey(survey, found, plan, path, title=""):
    """Plot the spectrum of a survey and label its components.

    ``plan``: adapted to the room.
    """
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 8), layout="constrained")
    axis, slow = canvas.subplots(2, 1, height_ratios=(3, 2))
    khz = survey.frequency_hz / 1e3
    level = 10 * np.log10(np.maximum(survey.spectrum, 1e-3))
    axis.plot(khz, level, lw=0.7, color=FAINT, label="spectrum of the untouched reference")
    own = (survey.own > _VISIBLE) & (level > _STANDS_OUT_DB)
    own &= survey.spectrum < 2 + _STRONGER * survey.own
    own[1:-1] &= (level[1:-1] >= level[:-2]) & (level[1:-1] >= level[2:])  # tops of lines
    around = np.convolve(own, np.ones(2 * _REACH + 1), "same") > 0
    axis.plot(
        khz,
        np.where(around, level, np.nan),
        lw=0.9,
        color=SERIES[0],
        label="higher and aliased lines of the scene's tags",
    )
    axis.axhline(0, color=INK, lw=1.0, ls="--", label="noise floor")
    if plan.clutter_hz:
        axis.axvspan(
            0,
            plan.clutter_hz / 1e3,
            color=SERIES[1],
            alpha=0.25,
            lw=0,
            label=f"rejected by the weights, 0 to {plan.clutter_hz:.0f} Hz",
        )
    for index, (name, clock) in enumerate(
        zip(plan.require_scene().sensor_names, plan.clocks, strict=True)
    ):
        lines = [m * clock.clock_hz for m in range(1, plan.harmonics + 1)]
        _mark(
            axis,
            survey,
            lines,
            f"lines of '{name}' ({clock.clock_hz:g} Hz)",
            color=SERIES[0],
            marker=_OWN_MARKERS[index % len(_OWN_MARKERS)],
        )
    for index, finding in enumerate(found):
        style = {
            "color": _FOUND[index % len(_FOUND)],
            "marker": _MARKERS[index % len(_MARKERS)],
        }
        label = f"{finding.name}, {finding.level_db:+.1f} dB"
        if finding.kind == "clutter":
            axis.axvline(finding.frequency_hz / 1e3, color=style["color"], lw=1.2, label=label)
        else:
            _mark(axis, survey, finding.lines_hz, label, **style)
    axis.set_xlim(0, khz[-1])
    axis.set_ylim(_LOWEST_DB, float(level.max()) + 5)
    axis.set_xlabel("frequency (kHz)")
    axis.set_ylabel("power above the noise floor (dB)")
    axis.set_title(title, fontsize=11)
    axis.grid(alpha=0.3)
    _plot_slow(slow, survey, found, plan)
    legend_below(canvas, *axis.get_legend_handles_labels(), ncols=2)
    save_picture(canvas, path)


def _plot_slow(axis, survey, found, plan):
    """Plot the frequencies below the lines of all tags, where people and machines move."""
    hertz = survey.frequency_hz[1:]
    level = 10 * np.log10(np.maximum(survey.spectrum[1:], 1e-3))
    top = min([clock.clock_hz for clock in plan.clocks], default=hertz[-1])
    axis.plot(hertz, level, lw=0.7, color=FAINT)
    axis.axhline(0, color=INK, lw=1.0, ls="--")
    if plan.clutter_hz:
        axis.axvspan(hertz[0], plan.clutter_hz, color=SERIES[1], alpha=0.25, lw=0)
    for index, finding in enumerate(found):
        if finding.kind == "clutter":
            axis.axvline(finding.frequency_hz, color=_FOUND[index % len(_FOUND)], lw=1.2)
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_xlim(hertz[0], top)
    axis.set_ylim(_LOWEST_DB, float(level[hertz <= top].max()) + 5)
    axis.set_xlabel("frequency below the lines of the tags (Hz)")
    axis.set_ylabel("the same power (dB)")
    axis.grid(alpha=0.3)


def _mark(axis, survey, lines_hz, label, **style):
    """Mark lines just above the spectrum."""
    rate, step_hz = 1 / survey.snapshot_period_s, survey.frequency_hz[1]
    level = 10 * np.log10(np.maximum(survey.spectrum, 1e-3))
    marks = []
    for hertz in lines_hz:
        seen = abs(aliased_hz(hertz, rate))
        middle = int(round(seen / step_hz))
        top = level[max(0, middle - _REACH) : middle + _REACH + 1].max()
        if top > _STANDS_OUT_DB:
            marks.append((seen / 1e3, top + 1.5))
    axis.plot(*np.reshape(marks, (-1, 2)).T, ls="", ms=6, label=label, **style)


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
    for difference in differences:
        warn(recording.path, difference)
    found = survey_room(recording, plan(scene))
    if plot_path is not None:
        plot_survey(found.survey, found.findings, found.plan, plot_path, title=str(capture))
    click.echo(json.dumps(found.report(), indent=2) if as_json else str(found))
