# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read``: readings of a capture, through the GNU Radio chain."""

import signal
import time

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.frame import find_frame_offset, keeps_alignment
from gnuradio.wiforce.io.capture import open_capture, second_antenna
from gnuradio.wiforce.io.writers import open_writer
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

from .progress import progress
from .stream_events import describe_events

_SEARCHED_FRAMES = 2000


@click.command()
@click.argument("capture", type=click.Path())
@click.option(
    "--scene",
    "scene_path",
    required=True,
    type=click.Path(),
    help="Scene file, or name of a shipped scene.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    help="OUT.csv or OUT.jsonl. Default: CSV on standard output.",
)
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a picture of the readings (PNG, PDF or SVG).",
)
@click.option(
    "--datatype",
    type=click.Choice(["ci16_le", "cf32_le"]),
    help="Type of the samples, for a raw file without metadata.",
)
@click.option(
    "--frame-offset",
    type=click.IntRange(0),
    help="Samples before the first frame. Default: detected.",
)
@click.option("--tracked", is_flag=True, help="Track each press over time.")
@click.option("--follow", is_flag=True, help="Keep reading while the capture grows, until ^C.")
def read(capture, scene_path, output, plot_path, datatype, frame_offset, tracked, follow):
    """Read force and location from a CAPTURE (SigMF pair, or raw samples with --datatype)."""
    scene = load_scene(scene_path)
    recording = open_capture(capture, datatype)
    recording.check_against(scene)
    settings = plan(scene)
    if follow:
        recording = wait_for_frames(recording, capture, datatype, settings.waveform)
    if frame_offset is None:
        frame_offset = find_offset(recording, settings.waveform)
    if not follow:
        warn_of_leftover(recording, scene, settings, frame_offset)
    if plot_path is not None:
        from .plots import check_picture

        check_picture(plot_path)
    kept = []
    rows = 0 if follow else int(recording.span / scene.group_samples) * len(scene.sensors)
    with open_writer(output) as writer, progress("reading", rows) as step:

        def on_reading(reading):
            writer.write(reading)
            if plot_path is not None:
                kept.append(reading)
            step(1)

        if follow:
            source = (capture, datatype)
            counts = follow_capture(source, scene, on_reading, frame_offset, tracked)
        else:
            counts = read_capture(recording, scene, on_reading, frame_offset, tracked)
    click.echo(f"gr-wiforce: read {counts}", err=True)
    if counts.groups and not counts.clear:
        rule = (
            "every reading is flagged; check the datatype, clock_hz and frame_length of the scene"
        )
        _warn(capture, f"{rule}, and the signal level")
    if plot_path is not None:
        from .plots import plot_readings

        plot_readings(kept, plot_path, title=str(capture))


def read_capture(recording, scene, on_reading, frame_offset=0, tracked=False, on_groups=None):
    """Runs the flowgraph over a whole recording.

    Parameters
    ----------
    recording : Capture
    scene : Scene
    on_reading : callable
        Called with every Reading, in order.
    frame_offset : int
        Samples before the first frame.
    tracked : bool
    on_groups : callable, optional
        Takes every batch of Groups, with the ratios R.

    Returns
    -------
    GroupCounts
    """
    from gnuradio import wiforce

    _silence_gnuradio()
    source = wiforce.capture_source(recording, scene, frame_offset)
    reader = wiforce.reader(scene, input_type="folded", tracked=tracked, on_reading=on_reading)
    reader.receiver.readout.on_groups = on_groups
    sources = {recording.path: source}
    if scene.environment.receive_antennas == 2:
        beside = second_antenna(recording.path.with_suffix(""))
        sources[beside] = second = wiforce.capture_source(beside, scene, frame_offset)
        settings = scene.sounding.waveform, scene.sounding.frame_length
        ratio = wiforce.antenna_ratio(*settings, scene.radio.sample_rate_hz)
        _run(reader, source, ratio, second=second)
    else:
        _run(reader, source)
    for path, source in sources.items():
        missing = source.samples_missing()
        if missing:
            _warn(path, f"was truncated while it was read; {missing} samples are missing")
        for event in describe_events(source.frames_moved()):
            _warn(path, event)
    return reader.counts


def follow_capture(capture, scene, on_reading, frame_offset, tracked):
    """Read a growing capture until interrupted; see `read_capture`.

    Parameters
    ----------
    capture : tuple
        Arguments of ``open_capture``.
    """
    from gnuradio import wiforce
    from gnuradio.wiforce.blocks.capture_stream import capture_stream

    _silence_gnuradio()
    source = capture_stream(*capture, scene.radio.sample_rate_hz)
    reader = wiforce.reader(
        scene, source.item_type, frame_offset, tracked=tracked, on_reading=on_reading
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: source.ended.set())
    _run(reader, source)
    if source.failure is not None:
        raise source.failure
    for event in describe_events(reader.fold.frames_moved(), reader.fold.times_ignored()):
        _warn(capture[0], event)
    return reader.counts


def _warn(capture, said):
    click.echo(f"gr-wiforce: warning: {capture}: {said}", err=True)


def _silence_gnuradio():
    """Stop its log, which would mix with readings on standard output."""
    from gnuradio import gr

    gr.logging().set_default_level(gr.log_levels.off)


def _run(reader, *chain, second=None):
    """Run a chain into the reader; ``second`` feeds the other input of its last block."""
    from gnuradio import gr

    flowgraph = gr.top_block("gr-wiforce read", catch_exceptions=False)
    flowgraph.connect(*chain, reader)
    if second is not None:
        flowgraph.connect(second, (chain[-1], 1))
    flowgraph.run()
    reader.finish()
    if reader.failure is not None:
        raise reader.failure


def wait_for_frames(recording, capture, datatype, waveform):
    """Wait until a recording holds enough frames to search for their offset; return it."""
    while recording.segments[0].length < _SEARCHED_FRAMES * waveform.frame_length:
        if len(recording.segments) > 1:
            break
        time.sleep(0.1)
        recording = open_capture(capture, datatype)
    return recording


def find_offset(recording, waveform):
    """Number of samples before the first frame; 0 where frames from there hold their preambles."""
    samples = recording.read(_SEARCHED_FRAMES * waveform.frame_length)
    offset = find_frame_offset(samples[: recording.segments[0].length], waveform)
    if offset is None or keeps_alignment(offset, waveform):
        return 0
    click.echo(f"gr-wiforce: {recording.path}: the first frame begins at sample {offset}", err=True)
    return offset


def warn_of_leftover(recording, scene, settings, frame_offset):
    """Warn of an incomplete last frame; refuse a capture that is too short for any reading.

    Raises
    ------
    InputError
        When the capture is shorter than the untouched reference and one more group.
    """
    groups = (recording.span - frame_offset) // scene.group_samples
    needed = settings.reference_groups + 1
    if groups < needed:
        shortest_s = needed * scene.group_period_s
        rule = (
            f"must hold {needed} phase groups after its first frame, the untouched reference and "
            f"one more ({shortest_s:.3g} s)"
        )
        raise InputError(recording.path, rule, max(0, groups))
    left = (recording.span - frame_offset) % scene.sounding.frame_length
    if left:
        rule = "after the last whole frame); only whole phase groups are read"
        _warn(recording.path, f"ends inside a frame ({left} samples {rule}")
