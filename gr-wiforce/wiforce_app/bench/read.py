# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench read``: time from a capture's file to readings."""

import itertools
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
from gnuradio.wiforce.estimation.capture.recorded_frames import first_frame
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.adaptation import adapted
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording_reader import groups_of, survey_recording
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

from ..shell.log import progress
from ..shell.options import FiniteRange
from ..shell.tables import Column, echo, table
from .live import RUN

# Clocks of up to eight tags, none of whose lines lies near one of another's.
_CLOCKS_HZ = (1000.0, 1400.0, 1790.0, 820.0, 1180.0, 1610.0, 1930.0, 1100.0)
# A piece of signal of this length holds whole frames, groups and, with clocks that are multiples of
# 1 / 3.6 s, whole periods: repeated, it has no break.
PIECE_SAMPLES, _SAMPLE_RATE_HZ = 45_000_000, 12.5e6
PIECE_S = PIECE_SAMPLES / _SAMPLE_RATE_HZ
_FRAME = 720
SENSORS = (1, 2, 4, 8)
GROUP_LENGTHS = (63, 125, 625)
# Groups that are read together (as of recordings), and batches that are timed: the lower quartile
# of so many repeats within 10 %. Sums differ by half, as what else the machine does lengthens some
# of them.
_BATCH, _TIMED = 256, 24
_SINGLE_GROUPS = 64  # of each batch, read once more one by one
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
@click.option(
    "--seconds",
    type=FiniteRange(4.0),
    default=60.0,
    help="Length of each recording.",
)
@click.option(
    "--sensors",
    multiple=True,
    type=click.Choice([str(count) for count in SENSORS]),
    help="Only this number of sensors.",
)
def read(as_json, seconds, sensors):
    """Measure the complete path from a capture's file to readings, and its stages.

    Recordings of 12.5 Msps (ci16_le, in the page cache) hold one to eight sensors, pressed in
    turns. The command is timed with its start-up; samples and groups are timed by themselves, by
    processor time, groups by its lower quartile over batches. A combination that the plan refuses,
    because its groups are too short to separate the tags, is left out.
    """
    counts, rows = [int(count) for count in sensors] or SENSORS, []
    with progress("measuring", len(counts) * len(GROUP_LENGTHS)) as step:
        for count in counts:
            with tempfile.TemporaryDirectory(prefix="wiforce-read-") as place:
                capture = _recorded(count, Path(place), seconds)
                for snapshots in GROUP_LENGTHS:
                    row = measure(capture, scene_of(count, snapshots))
                    rows += [] if row is None else [{"sensors": count, **row}]
                    step(1)
    echo(rows, as_json, lambda _: table(rows, COLUMNS))


def scene_of(sensors, snapshots):
    """The scene of a row, as a mapping: sensors that are pressed in turns."""
    names = [f"sensor{i + 1}" for i in range(sensors)]
    return {
        "phase_group": {"snapshots": snapshots},
        "sensors": [
            {"name": name, "model": "line-900mhz", "clock_hz": clock_hz}
            for name, clock_hz in zip(names, _CLOCKS_HZ, strict=False)
        ],
        "simulation": {
            "duration_s": (PIECE_SAMPLES + _FRAME / 2) / _SAMPLE_RATE_HZ,
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
                    "location_mm": 30.0 + 2 * i,
                }
                for i, name in enumerate(names)
            ],
        },
    }


def _recorded(sensors, folder, seconds):
    """The capture of some sensors: a piece, repeated; it does not depend on the groups."""
    capture = folder / "capture"
    simulate(load_scene(scene_of(sensors, GROUP_LENGTHS[-1])), capture)
    data = capture.with_suffix(".sigmf-data")
    piece = data.read_bytes()
    pieces = int(np.ceil(seconds / PIECE_S))
    if len(piece) * (pieces - 1) > shutil.disk_usage(folder).free:
        rule = f"must leave room for recordings of {len(piece) * pieces / 1e9:.1f} GB"
        raise click.BadParameter(f"{rule}, got {seconds:g}", param_hint="--seconds")
    with open(data, "ab") as stream:
        for _ in range(pieces - 1):
            stream.write(piece)
    return capture


def measure(capture, scene):
    """The row of a scene, from its recording; None when the plan refuses it."""
    try:
        settings = plan(scene)
    except InputError:
        return None
    recording = open_capture(capture)
    signal_s = recording.span / recording.sample_rate_hz
    offset, _ = first_frame(recording, settings.waveform)
    settings = adapted(settings, survey_recording(recording, settings, offset))
    samples_s, tones = _time_samples(recording, settings)
    group_s, single_s = _time_groups(settings, tones)
    read_s, cpu_s = _time_command(capture, scene)
    return {
        "snapshots": settings.group_length,
        "tones": len(settings.table.tones),
        "samples_ms": 1e3 * samples_s / signal_s,
        "group_us": 1e6 * group_s,
        "single_us": 1e6 * single_s,
        "read_s": read_s,
        "cpu_s": cpu_s,
        "real_time": signal_s / read_s,
    }


def _time_command(capture, scene):
    """Wall and processor time of ``gr-wiforce read``."""
    path = capture.with_name("scene.yaml")
    path.write_text(yaml.safe_dump(scene), encoding="utf-8")
    command = [sys.executable, "-c", RUN, "read", str(capture), "--scene", str(path)]
    command += ["-o", str(capture) + ".csv"]
    # Users have the compiled files of a start before.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL, env=environment)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, sum(after[:2]) - sum(before[:2])


def _time_samples(recording, settings):
    """Processor time from samples to tones, and those of the first piece."""
    source, batches = groups_of(recording, settings, 0), []
    piece = PIECE_SAMPLES // settings.waveform.frame_length // settings.group_length
    start = time.process_time()
    while len(groups := source.read()):
        if sum(map(len, batches)) < piece:
            batches.append(groups)
    return time.process_time() - start, Groups.concatenate(batches)[:piece]


def _time_groups(settings, piece):
    """Processor time of a group in a batch and alone, once clocks and reference are known."""
    together, alone, took = Receiver(settings), Receiver(settings), []
    for first in itertools.count(0, _BATCH):
        index = first + np.arange(_BATCH)
        batch = piece[index % len(piece)].having(index=index)
        known = alone.state == "reading"
        single = [batch[i : i + 1] for i in range(_SINGLE_GROUPS * known)]
        pair = _seconds(together, [batch]), _seconds(alone, single)
        alone.process(batch[len(single) :])
        if known:
            took.append((pair[0] / _BATCH, pair[1] / len(single)))
        if len(took) == _TIMED:
            return np.quantile(took, 0.25, axis=0).tolist()


def _seconds(receiver, batches):
    start = time.process_time()
    for batch in batches:
        receiver.process(batch)
    return time.process_time() - start
