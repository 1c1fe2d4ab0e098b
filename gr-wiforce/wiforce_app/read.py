# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read``: force and location from a capture."""

import click
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.channel_snapshots import (
    ChannelSnapshots,
    is_snapshots,
    open_snapshots,
)
from gnuradio.wiforce.planning.findings import findings
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.recording import RecordingReader
from gnuradio.wiforce.scene import scene_of
from gnuradio.wiforce.snapshot_recording import SnapshotReader

from .captures.search import is_one
from .file_outputs import FileOutputs
from .interrupts import Interrupted
from .options import (
    IntegerRange,
    capture_scene,
    mcap_output,
    sample_type,
    tracked_presses,
    worker_options,
)
from .progress import progress
from .room_report import RoomNews
from .stream_events import describe_events


@click.command()
@click.argument("captures", nargs=-1, required=True, type=click.Path(), metavar="CAPTURE...")
@capture_scene
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    help="OUT.csv, OUT.jsonl or OUT.parquet; of several captures a folder, for a file of each, or "
    "one OUT.parquet. Default: CSV on standard output.",
)
@mcap_output
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a picture of the readings (PNG, PDF or SVG).",
)
@sample_type
@click.option(
    "--csi-tool",
    metavar="TOOL",
    help="The file is one of channel snapshots by a CSI tool: intel, atheros, esp32 or "
    "nexmon/CHIP/MHZ.",
)
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
    type=click.Choice(["csv", "jsonl", "parquet"]),
    help="Of the files in a folder. Default: csv.",
)
@click.option("--again", is_flag=True, help="Read captures that have been read before as well.")
@worker_options
def read(
    captures,
    scene_path,
    output,
    mcap,
    plot_path,
    follow,
    form,
    again,
    jobs,
    scheduler,
    **settings,
):
    """Read force and location from each CAPTURE.

    A CAPTURE is a SigMF pair, a file of raw samples with --datatype, a file of channel snapshots
    (.npz), a folder that is searched for these, or a pattern such as 'day*/press*'. Several
    captures are read in parallel; a run that is repeated reads those that are new or have changed.
    """
    if settings["csi_tool"] is not None:
        from gnuradio.wiforce.io.csi_tools import check_tool

        check_tool(settings["csi_tool"])
    if is_one(captures):
        one = {"--format": form, "--again": again, "--jobs": jobs, "--scheduler": scheduler}
        _refuse(one, "needs several captures or a folder")
        return _read_one(captures[0], scene_path, output, mcap, plot_path, follow, **settings)
    of_one = {"--mcap": mcap, "--plot": plot_path, "--follow": follow}
    _refuse({**of_one, "--csi-tool": settings.pop("csi_tool")}, "takes one capture")
    from .captures.read_many import read_many

    return read_many(captures, scene_path, output, form, again, jobs, scheduler, settings)


def _refuse(options, rule):
    for option, value in options.items():
        if value:
            raise click.UsageError(f"{option} {rule}")


def _read_one(
    capture, scene_path, output, mcap, plot_path, follow, datatype, csi_tool, frame_offset, tracked
):
    if csi_tool is not None or is_snapshots(capture):
        _refuse(
            {
                "--datatype": datatype,
                "--frame-offset": frame_offset is not None,
                "--follow": follow,
            },
            "is for captures of samples, not for channel snapshots",
        )
    recording = open_recording(capture, datatype, csi_tool)
    scene, differences = scene_of(recording, scene_path)
    settings = plan(scene)
    inputs = [*recording.files, *scene.files]
    if plot_path is not None:
        from .plots import check_picture

        check_picture(plot_path, inputs)
    writer = FileOutputs(output, mcap, inputs, scene)
    if follow:
        from .follow import GrowingCapture

        reader = GrowingCapture(capture, datatype, settings, frame_offset, tracked)
    else:
        reader = open_reader(recording, settings, frame_offset, tracked)
    warn_of_start(recording, reader, differences, frame_offset)
    kept = []
    rows = 0 if follow else reader.groups * len(scene.reading_names)
    try:
        with writer, progress("reading", rows) as step:
            for batch in reader:
                for reading in batch:
                    writer.write(reading)
                if plot_path is not None:
                    kept += batch
                step(len(batch))
    except KeyboardInterrupt as interrupt:
        raise Interrupted(_partial(writer, output, rows)) from interrupt
    warn_of_end(capture, reader)
    click.echo(f"gr-wiforce: read {reader.counts}", err=True)
    if plot_path is not None:
        from .plots import plot_readings

        plot_readings(kept, plot_path, title=str(capture))
    return 0


def open_recording(path, datatype, csi_tool=None):
    """A capture of samples, or a file of channel snapshots.

    Parameters
    ----------
    path : str
    datatype : str or None
        Of raw samples, whatever the name of their file is.
    csi_tool : str, optional
        That has written the file.

    Returns
    -------
    Capture or ChannelSnapshots
    """
    if csi_tool is not None:
        from gnuradio.wiforce.io.csi_tools import open_csi

        return open_csi(path, csi_tool)
    if datatype is None and is_snapshots(path):
        return open_snapshots(path)
    return open_capture(path, datatype)


def open_reader(recording, settings, frame_offset, tracked):
    """The reader of a recording, after warnings of what was left out and of what is in the room.

    Parameters
    ----------
    recording : Capture or ChannelSnapshots
    settings : Plan
    frame_offset : int or None
        Samples before the first frame; searched when None.
    tracked : bool

    Returns
    -------
    RecordingReader or SnapshotReader
    """
    if isinstance(recording, ChannelSnapshots):
        reader = SnapshotReader(recording, settings, tracked)
        for note in reader.notes:
            warn(recording.path, note)
        return reader
    reader = RecordingReader(recording, settings, frame_offset, tracked)
    warn_of_leftover(recording, reader)
    RoomNews().report(findings(reader.survey, settings, reader.plan))
    return reader


def warn_of_start(recording, reader, differences, frame_offset):
    """Warn of differences between two scenes, and mention where the first frame was found."""
    for difference in differences:
        warn(recording.path, difference)
    if frame_offset is None and getattr(reader, "frame_offset", 0):
        first = f"the first frame begins at sample {reader.frame_offset}"
        click.echo(f"gr-wiforce: {recording.path}: {first}", err=True)


def warn_of_end(capture, reader):
    """Warn of what was wrong with a recording that has been read."""
    warn_of_events(reader)
    for name, found in reader.suspicions().items():
        for suspicion in found:
            warn(capture, f"{name}: {suspicion.text}")
    counts = reader.counts
    if counts.groups and not counts.clear:
        rule = (
            "every reading is flagged; check the datatype, clock_hz and frame_length of the scene"
        )
        if isinstance(reader, SnapshotReader):
            rule = "every reading is flagged; check clock_hz and packets of the scene"
        warn(capture, f"{rule}, and the signal level")


def _partial(writer, output, rows):
    """What an interrupted run has written."""
    if not writer.rows:
        return "nothing has been written"
    return f"{output or 'the output'} is partial: it holds the first {writer.rows} of {rows} rows"


def read_capture(recording, scene, on_reading, frame_offset=0, tracked=False, on_groups=None):
    """Read a whole recording for another command, and warn of what was wrong with it.

    Parameters
    ----------
    recording : Capture
    scene : Scene
    on_reading : callable
        Called with every Reading, in order.
    frame_offset : int or None
        Samples before the first frame; searched when None.
    tracked : bool
    on_groups : callable, optional
        Called with every batch of Groups that has been read, with the ratios R.

    Returns
    -------
    GroupCounts
    """
    reader = RecordingReader(recording, plan(scene), frame_offset, tracked, on_groups)
    warn_of_leftover(recording, reader)
    for batch in reader:
        for reading in batch:
            on_reading(reading)
    warn_of_events(reader)
    return reader.counts


def warn(path, text):
    """Print a warning about a file."""
    click.echo(f"gr-wiforce: warning: {path}: {text}", err=True)


def warn_of_events(reader):
    """Warn of samples that a file lacked, and of frames that moved."""
    for path, missing in reader.samples_missing().items():
        if missing:
            warn(path, f"was truncated while it was read; {missing} samples are missing")
    for path, moved in reader.frames_moved().items():
        for event in describe_events(moved, reader.times_ignored):
            warn(path, event)


def warn_of_leftover(recording, reader):
    """Warn of samples behind the last whole frame, and of antennas recorded for different times."""
    antennas = sorted(reader.source.captures, key=lambda capture: capture.span)
    lacking = antennas[-1].span - antennas[0].span
    if lacking:
        seconds = lacking / reader.plan.waveform.sample_rate_hz
        rule = f"ends {lacking} samples ({seconds:.3g} s) before {antennas[-1].path}"
        warn(antennas[0].path, f"{rule}; groups that lack one antenna cannot be read")
    if reader.leftover:
        rule = "after the last whole frame); only whole phase groups are read"
        warn(recording.path, f"ends inside a frame ({reader.leftover} samples {rule}")
