# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce survey``: what a capture holds besides the tags of its scene."""

import json

import click
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.captures import survey_room
from gnuradio.wiforce.scene import scene_of

from ..read.recordings import warn
from ..shell.options import capture_scene, refuse_scenes, sample_type


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
        from ..shell.plots import check_picture

        check_picture(plot_path, [*recording.files, *scene.files])
    for difference in differences:
        warn(recording.path, difference)
    found = survey_room(recording, plan(scene))
    if plot_path is not None:
        from .survey_plot import plot_survey

        plot_survey(found.survey, found.findings, found.plan, plot_path, title=str(capture))
    click.echo(json.dumps(found.report(), indent=2) if as_json else str(found))
