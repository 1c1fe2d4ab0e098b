# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read``: force and location from a capture."""

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture.names import is_one
from gnuradio.wiforce.io.files import OUTPUTS

from ..shell.commands import GroupedHelp
from ..shell.options import (
    IntegerRange,
    capture_scene,
    csi_file,
    csi_options,
    mcap_output,
    readings_outputs,
    refuse,
    refuse_scenes,
    sample_type,
    tracked_presses,
    worker_options,
)


@click.command(
    cls=GroupedHelp,
    groups={
        "Options": "--output --plot --scene --mcap --tracked --follow --datatype --frame-offset",
        "Many captures": "--format --again --jobs",
        "Channel snapshots": "--csi-tool --mac --second-antenna",
    },
    examples=("read press -o press.csv --plot press.png", "read captures -o readings"),
)
@click.argument("captures", nargs=-1, required=True, type=click.Path(), metavar="CAPTURE...")
@capture_scene
@readings_outputs("Of several captures: a folder, for a file of each, or one OUT.parquet. ")
@mcap_output
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a picture of the readings (PNG, PDF or SVG).",
)
@sample_type
@csi_options
@click.option(
    "--frame-offset",
    type=IntegerRange(0),
    help="Samples before the first frame. Default: detected; where no frames are detected, nothing "
    "is read.",
)
@tracked_presses
@click.option("--follow", is_flag=True, help="Keep reading while the capture grows, until ^C.")
@click.option(
    "--format",
    "form",
    type=click.Choice([each.suffix[1:] for each in OUTPUTS]),
    help="Of the files in a folder. Default: csv.",
)
@click.option("--again", is_flag=True, help="Read captures that have been read before as well.")
@worker_options
def read(
    captures,
    scene_path,
    outputs,
    mcap,
    plot_path,
    follow,
    form,
    again,
    jobs,
    **settings,
):
    """Read force and location from each CAPTURE.

    A CAPTURE is a SigMF pair, a file of raw samples with --datatype, a file of channel snapshots
    (.npz), a folder that is searched for these, or a pattern such as 'day*/press*'. Several
    captures are read in parallel; a run that is repeated reads those that are new or have changed.
    """
    settings["csi"] = csi_file(
        settings.pop("csi_tool"), settings.pop("mac"), settings.pop("second_antenna")
    )
    refuse_scenes(captures)
    if is_one(captures):
        one = {"--format": form, "--again": again, "--jobs": jobs}
        refuse(one, "needs several captures or a folder")
        from .read_one import read_one

        return read_one(captures[0], scene_path, outputs, mcap, plot_path, follow, **settings)
    of_one = {"--mcap": mcap, "--plot": plot_path, "--follow": follow}
    refuse({**of_one, "--csi-tool": settings.pop("csi")}, "takes one capture")
    if len(outputs) > 1:
        raise InputError("--output", "must be given once for several captures", outputs[1])
    from .read_many import read_many

    return read_many(captures, scene_path, next(iter(outputs), None), form, again, jobs, settings)
