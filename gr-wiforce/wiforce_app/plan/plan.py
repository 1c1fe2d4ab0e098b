# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce plan``: the steps of a scene, their cost, and the errors to expect."""

import dataclasses
import json
from functools import partial

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.palette import GRID, INK, SERIES
from gnuradio.wiforce.planning.advice import improve as proposals_for
from gnuradio.wiforce.planning.advice import licence_note
from gnuradio.wiforce.planning.advice import warnings as warnings_of
from gnuradio.wiforce.planning.clocks import clocks_for
from gnuradio.wiforce.planning.expected import error_map, expect
from gnuradio.wiforce.planning.plan import plan as plan_of
from gnuradio.wiforce.planning.steps import steps as steps_of
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.simulated import MAX_SENSORS

from ..shell.commands import GroupedHelp
from ..shell.options import IntegerRange, sample_type, scene_names
from ..shell.plots import check_picture, save_picture


@click.command(
    cls=GroupedHelp,
    groups={"Options": "--improve --steps --plot --capture --datatype --clocks --json"},
    examples=("plan demo --improve", "plan scene.yaml --capture press", "plan demo --clocks 4"),
)
@click.argument("scene", metavar="SCENE.yaml", shell_complete=scene_names)
@click.option(
    "--capture",
    "capture_path",
    type=click.Path(),
    help="Survey the room of a capture, and show what the plan adds or skips because of it.",
)
@sample_type
@click.option("--improve", is_flag=True, help="Propose better settings and state their effect.")
@click.option("--steps", "with_steps", is_flag=True, help="Show each step, its cost, and why.")
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a map of the errors over force and location (PNG, PDF or SVG).",
)
@click.option(
    "--clocks",
    type=IntegerRange(1, MAX_SENSORS),
    help="Propose clocks for so many sensors in this scene, and show nothing else.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def plan(scene, capture_path, datatype, improve, with_steps, plot_path, clocks, as_json):
    """Show which errors to expect of a SCENE, what limits them, and what would improve it.

    Noise, clutter and presses are taken from the section simulation of the scene.
    """
    if datatype is not None and capture_path is None:
        raise click.UsageError("--datatype is that of a recording: give --capture as well")
    scene = load_scene(scene)
    if clocks is not None:
        _propose_clocks(scene, clocks, as_json)
        return
    check_picture(plot_path, scene.files)
    settings = plan_of(scene)
    report = {
        "settings": _settings(settings),
        "steps": [dataclasses.asdict(step) for step in steps_of(settings)],
        "expected": [dataclasses.asdict(sensor) for sensor in expect(settings)],
        "warnings": warnings_of(settings),
        "notes": list(licence_note(scene)),
    }
    room = None
    if capture_path is not None:
        from gnuradio.wiforce.io.capture import open_capture
        from gnuradio.wiforce.receiver.captures import survey_room

        from ..read.recordings import warn

        recording = open_capture(capture_path, datatype)
        room = survey_room(recording, scene, [], partial(warn, recording.path))
        found = room.report()
        report["room"] = {
            **{key: found[key] for key in ("findings", "changes", "skipped")},
            "settings": _settings(room.plan),
            "steps": [dataclasses.asdict(step) for step in steps_of(room.plan)],
        }
    if improve:
        report["proposals"] = [dataclasses.asdict(p) for p in proposals_for(settings)]
    if plot_path is not None:
        _plot_errors(settings, plot_path)
    if as_json:
        click.echo(json.dumps(report, indent=2))
        return
    _print(report, str(settings), with_steps)
    if room is not None:
        click.echo(f"\nroom of the capture: {room}")


def _propose_clocks(scene, count, as_json):
    """Print clocks for some sensors; nothing of the scene's own is planned."""
    try:
        found = clocks_for(scene, count)
    except InputError as error:
        raise error.renamed({"count": "--clocks"}) from error
    if as_json:
        click.echo(json.dumps(dataclasses.asdict(found), indent=2))
        return
    click.echo("\n".join(f"clock_hz: {hz:.9g}" for hz in found.clocks_hz))
    if found.line_distance_hz is not None:
        click.echo(
            f"lines 1, 2 and 4 of different sensors lie {found.line_distance_hz:.3g} Hz or more "
            f"apart ({found.line_distance_hz / found.bin_hz:.2g} bins of {found.bin_hz:.3g} Hz)"
        )
    if found.lamp_distances_hz is not None:
        near = sum(hz < found.bin_hz for hz in found.lamp_distances_hz)
        click.echo(f"sensors with one of these lines within one bin of a lamp's: {near} of {count}")
    click.echo(f"cost of neighbours, aliases and clutter: {found.worst_loss_db:.2g} dB or less")


def _settings(settings):
    return {
        "waveform": settings.waveform.name,
        "snapshot_rate_hz": 1 / settings.waveform.snapshot_period_s,
        "group_length": settings.group_length,
        "group_period_s": settings.group_period_s,
        "clutter_hz": settings.clutter_hz,
        "harmonics": settings.harmonics,
        "tones": len(settings.table.tones),
        "reference_groups": settings.reference_groups,
        "smoothing_groups": settings.smoothing_groups,
        "estimator": settings.estimator,
        "loss_db": list(settings.loss_db),
    }


def _print(report, summary, with_steps):
    chosen, *expected = summary.splitlines()
    click.echo("\n".join(expected))
    for warning in report["warnings"]:
        click.echo(f"warning: {warning}")
    for note in report["notes"]:
        click.echo(f"note: {note}")
    for proposal in report.get("proposals", ()):
        std, time = proposal["phase_std_deg"], proposal["time_resolution_s"]
        click.echo(
            f"proposal: {proposal['change']}: {proposal['reason']} (noise {std[0]:.3g} -> "
            f"{std[1]:.3g} deg, a reading in {1e3 * time[0]:.3g} -> {1e3 * time[1]:.3g} ms)"
        )
    if "proposals" in report and not report["proposals"]:
        click.echo("no better settings found")
    click.echo(f"\n{chosen}")
    if with_steps:
        _print_steps(report["steps"])


def _print_steps(steps):
    click.echo(f"\n{'step':<28}{'needed':<8}{' Mflop/s'}  why")
    for step in steps:
        cost = f"{step['operations'] / 1e6:8.3g}"
        click.echo(
            f"{step['name']:<28}{'yes' if step['needed'] else 'skipped':<8}{cost}  {step['reason']}"
        )
    for needed, label in ((True, "needed"), (False, "skipped")):
        cost = sum(step["operations"] for step in steps if step["needed"] == needed) / 1e6
        click.echo(f"{label}: {cost:.3g} Mflop per second of signal")


_STEPS, _LEVELS = 61, 7
_PANEL_IN = 2.6


def _plot_errors(settings, path):
    """Draw the standard deviations of force and location of every sensor, side by side."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

    shades = LinearSegmentedColormap.from_list("errors", [GRID, SERIES[0]])
    colors = shades(np.linspace(0, 1, _LEVELS - 1))
    count = len(settings.sensors)
    canvas = Figure(figsize=(10, 0.7 + _PANEL_IN * count), layout="constrained")
    rows = canvas.subplots(count, 2, squeeze=False, sharex="row", sharey="row")
    canvas.suptitle("expected standard deviations of a steady reading", fontsize=11)
    for index, (axes, sensor) in enumerate(zip(rows, settings.sensors, strict=True)):
        force, location = (
            np.linspace(*span, _STEPS)
            for span in (sensor.model.force_span_n, sensor.model.location_span_mm)
        )
        spread = error_map(settings, index, force, location)
        for axis, values, name in zip(
            axes, np.moveaxis(spread, -1, 0), ("force (N)", "location (mm)"), strict=True
        ):
            levels = np.geomspace(values.min(), 1.01 * values.max(), _LEVELS)
            drawn = axis.contourf(location, force, values, levels, colors=colors)
            axis.contour(drawn, colors=INK, linewidths=0.6)
            canvas.colorbar(drawn, ax=axis, format="%.2g", aspect=12)
            axis.set_title(f"{sensor.name}: std of {name}", fontsize=10)
        axes[0].set_ylabel("force (N)")
    for axis in rows[-1]:
        axis.set_xlabel("location (mm from port 1)")
    save_picture(canvas, path)
