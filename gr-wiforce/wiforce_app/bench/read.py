# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench read``: the complete path from a capture's file to readings, timed."""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import yaml
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

from ..shell.markdown import markdown_table
from ..shell.options import FiniteRange
from ..shell.progress import progress
from .report import Column, echo, head_and_cells
from .scaling import AXES
from .scaling import measure as scaling_of
from .scaling import table as scaling_table

# Clocks of up to eight tags, none of whose lines lies near one of another's. In the piece of signal
# that is repeated all make whole cycles, so that a recording of any length has no break.
_CLOCKS_HZ = (1000.0, 1400.0, 1790.0, 820.0, 1180.0, 1610.0, 1930.0, 1100.0)
_PIECE_FRAMES = 62_500  # 3.6 s
_SENSORS = (1, 2, 4, 8)
_GROUP_LENGTHS = (63, 125, 625)
_SINGLE_GROUPS = 200  # timed one by one


# Times are wall time of ``gr-wiforce read``, start-up included, processor time of all its threads,
# processor time from samples to tones per second of signal, and processor time from tones to
# readings per group, in batches and one group at a time.
COLUMNS = (
    Column("sensors", "sensors"),
    Column("N_g", "snapshots"),
    Column("tones", "tones"),
    Column("x real time", "real_time", ".1f"),
    Column("wall (s)", "read_s", ".2f"),
    Column("processor (s)", "cpu_s", ".2f"),
    Column("samples (ms/s)", "samples_ms", ".1f"),
    Column("batches (us/group)", "group_us", ".0f"),
    Column("single (us/group)", "single_us", ".0f"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Rows as JSON.")
@click.option("--seconds", type=FiniteRange(4.0), help="Length of each recording. Default: 60.")
@click.option(
    "--sensors",
    multiple=True,
    type=click.Choice([str(count) for count in _SENSORS]),
    help="Only this number of sensors.",
)
@click.option("--folder", type=click.Path(exists=True, file_okay=False), help="For recordings.")
@click.option(
    "--scaling",
    is_flag=True,
    help="Measure how times grow with sensors, group length, snapshot rate and subcarriers.",
)
@click.option(
    "--axis",
    "axes",
    multiple=True,
    type=click.Choice(list(AXES)),
    help="With --scaling: only along this axis (repeatable).",
)
@click.option(
    "--plot", "plot_path", type=click.Path(), help="With --scaling: write a picture (PNG)."
)
def read(as_json, seconds, sensors, folder, scaling, axes, plot_path):
    """Measure the complete path from a capture's file to readings, and its stages.

    Recordings of 12.5 Msps (ci16_le, in the page cache) hold one to eight sensors, pressed in
    turns. The command is timed with its start-up; samples and groups are timed by themselves, by
    processor time. A combination that the plan refuses, because its groups are too short to
    separate the tags, is left out.

    With --scaling, one of sensors, snapshots per group, snapshots per second and samples per symbol
    changes at a time, and the exponents by which the times grow are printed.
    """
    if scaling:
        if seconds is not None or sensors:
            raise click.UsageError("--seconds and --sensors do not apply with --scaling")
        _measure_scaling(as_json, folder, axes or list(AXES), plot_path)
        return
    if axes or plot_path is not None:
        raise click.UsageError("--axis and --plot apply with --scaling only")
    seconds = 60.0 if seconds is None else seconds
    rows = []
    counts = [int(count) for count in sensors] or _SENSORS
    with (
        tempfile.TemporaryDirectory(prefix="wiforce-read-", dir=folder) as place,
        progress("measuring", len(counts) * len(_GROUP_LENGTHS)) as step,
    ):
        for count in counts:
            capture = _record(Path(place), count, seconds)
            for snapshots in _GROUP_LENGTHS:
                row = _measure(capture, count, snapshots)
                rows += [] if row is None else [row]
                step(1)
            for path in Path(place).iterdir():
                path.unlink()
    echo(rows, as_json, lambda: markdown_table(*head_and_cells(rows, COLUMNS)))


def _measure_scaling(as_json, folder, axes, plot_path):
    """Rows along each axis, and how they grow."""
    if plot_path is not None:
        from ..shell.plots import check_picture

        check_picture(plot_path)
    result = scaling_of(axes, folder)
    if plot_path is not None:
        from .picture import plot_scaling

        plot_scaling(result, plot_path)
    echo(result, as_json, lambda: scaling_table(result))


def scene_of(sensors, snapshots, duration_s=4.0):
    """The scene of a row, as a mapping."""
    names = [f"sensor{i + 1}" for i in range(sensors)]
    return {
        "phase_group": {"snapshots": snapshots},
        "sensors": [
            {"name": name, "model": "line-900mhz", "clock_hz": clock_hz}
            for name, clock_hz in zip(names, _CLOCKS_HZ, strict=False)
        ],
        "simulation": {
            "duration_s": duration_s,
            "seed": 1,
            "snr_db": 15,
            "static_clutter_db": 50,
            "clock_offset_ppm": 0,
            "clock_drift_ppm_per_s": 0,
            "presses": [
                {
                    "sensor": name,
                    "start_s": 0.8 + 0.3 * i,
                    "rise_s": 0.02,
                    "hold_s": 0.5,
                    "force_n": 4.0,
                    "end_force_n": 5.0,
                    "location_mm": 30.0 + 3 * i,
                }
                for i, name in enumerate(names)
            ],
        },
    }


def _record(folder, sensors, seconds):
    """A capture of some sensors: a simulated piece, repeated."""
    period_s = 720 / 12.5e6
    scene = load_scene(scene_of(sensors, 625, (_PIECE_FRAMES + 0.5) * period_s))
    capture = folder / "capture"
    simulate(scene, capture)
    data = capture.with_suffix(".sigmf-data")
    piece = data.read_bytes()
    pieces = int(np.ceil(seconds / (_PIECE_FRAMES * period_s)))
    if len(piece) * pieces > shutil.disk_usage(folder).free:
        rule = f"must leave room for recordings of {len(piece) * pieces / 1e9:.1f} GB"
        raise click.BadParameter(f"{rule}, got {seconds:g}", param_hint="--seconds")
    with open(data, "ab") as stream:
        for _ in range(pieces - 1):
            stream.write(piece)
    return capture


def _measure(capture, sensors, snapshots):
    """The row of a capture read in groups of some length; None when the plan refuses it."""
    try:
        settings = plan(scene_of(sensors, snapshots))
    except InputError:
        return None
    recording = open_capture(capture)
    signal_s = recording.span / recording.sample_rate_hz
    read_s, cpu_s = _time_command(capture, sensors, snapshots)
    samples_s, group_s, single_s = _time_stages(recording, settings)
    return {
        "sensors": sensors,
        "snapshots": snapshots,
        "tones": len(settings.table.tones),
        "signal_s": signal_s,
        "read_s": read_s,
        "cpu_s": cpu_s,
        "real_time": signal_s / read_s,
        "samples_ms": 1e3 * samples_s / signal_s,
        "group_us": 1e6 * group_s,
        "single_us": 1e6 * single_s,
    }


def _time_command(capture, sensors, snapshots):
    """Wall and processor time of ``gr-wiforce read``."""
    scene = capture.with_name("scene.yaml")
    scene.write_text(yaml.safe_dump(scene_of(sensors, snapshots)), encoding="utf-8")
    command = [sys.executable, "-c", "from wiforce_app.main import run; raise SystemExit(run())"]
    command += ["read", str(capture), "--scene", str(scene), "-o", str(capture) + ".csv"]
    # Users have the compiled files of a start before.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL, env=environment)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, sum(after[:2]) - sum(before[:2])


def _time_stages(recording, settings):
    """Processor time from samples to tones, and per group from tones to readings."""
    source, batches = RecordingReader(recording, settings, 0).source, []
    start = time.process_time()
    while len(groups := source.read()):
        batches.append(groups)
    samples_s = time.process_time() - start
    receiver = Receiver(settings)
    if len(batches) == 1:  # of a short recording
        (whole,) = batches
        batches = [whole[: len(whole) // 2], whole[len(whole) // 2 :]]
    started = batches.pop(0)  # clocks and reference are found once
    receiver.process(started)
    groups = batches.pop() if len(batches) > 1 else batches[-1]
    start = time.process_time()
    for batch in batches:
        receiver.process(batch)
    group_s = (time.process_time() - start) / max(sum(map(len, batches)), 1)
    single = [groups[i : i + 1] for i in range(min(len(groups), _SINGLE_GROUPS))]
    start = time.process_time()
    for group in single:
        receiver.process(group)
    return samples_s, group_s, (time.process_time() - start) / len(single)
