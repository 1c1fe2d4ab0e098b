# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce survey``: what a capture holds besides the tags of its scene."""

import json
from dataclasses import asdict

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.findings import findings, level_reference
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.recording import RecordingReader
from gnuradio.wiforce.scene import scene_of

from .captures.recordings import warn
from .captures.search import refuse_scenes
from .options import capture_scene, sample_type
from .room_report import (
    changes_of,
    finding_rows,
    findings_text,
    measure_tag,
    sensor_text,
    skipped_of,
)


@click.command()
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
    if plot_path is not None:
        from .plots import check_picture

        check_picture(plot_path, [*recording.files, *scene.files])
    settings = plan(scene)
    groups = []
    reader = RecordingReader(recording, settings, on_groups=groups.append)
    found = surveyed(recording, reader)
    for difference in differences:
        warn(recording.path, difference)
    next(iter(reader))
    tags = groups[0] if groups else Groups(np.zeros(0, np.int64))
    listed = findings(found, settings, reader.plan)
    reference, name = level_reference(found, settings)
    report = {
        "seconds": len(found.spectrum) * 2 * found.snapshot_period_s,
        "resolution_hz": found.resolution_hz,
        "noise_floor_db": float(-10 * np.log10(reference)),
        "static_db": float(10 * np.log10(max(found.static_power, 1e-30) / reference)),
        "level_reference": name,
        "findings": finding_rows(listed),
        "changes": changes_of(settings, reader.plan),
        "skipped": skipped_of(reader.plan),
        "sensors": [
            asdict(measure_tag(sensor.name, index, tags))
            for index, sensor in enumerate(scene.sensors)
        ],
    }
    if plot_path is not None:
        from .survey_plot import plot_survey

        plot_survey(found, listed, reader.plan, plot_path, title=str(capture))
    if as_json:
        click.echo(json.dumps(report, indent=2))
    else:
        _print(report, listed, tags, scene)


def surveyed(recording, reader):
    """The survey that a reader has made.

    Raises
    ------
    InputError
        Where there is none.
    """
    if reader.survey is None:
        rule = "cannot be surveyed: needs 0.1 s of untouched reference without gaps"
        raise InputError(recording.path, rule)
    return reader.survey


def _print(report, listed, tags, scene):
    click.echo(
        f"{report['seconds']:.2f} s of untouched reference; levels in dB relative to "
        f"{report['level_reference']}"
    )
    click.echo(f"noise of a snapshot {report['noise_floor_db']:.1f} dB")
    click.echo(f"static channel      {report['static_db']:.1f} dB")
    for index, sensor in enumerate(scene.sensors):
        text = sensor_text(measure_tag(sensor.name, index, tags))
        click.echo(f"{sensor.name + ' ':<20}{text}")
    click.echo("")
    for line in findings_text(listed):
        click.echo(line)
    click.echo("")
    for change in report["changes"]:
        click.echo(f"needed: {change}")
    for skipped in report["skipped"]:
        click.echo(f"skipped: {skipped}")
