# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench read``: time from a capture's file to readings, and how it grows."""

import itertools
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np
import yaml
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.recorded_frames import first_frame, require_frames
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.adaptation import adapted
from gnuradio.wiforce.planning.clocks import clocks_for
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording import groups_of, survey_recording
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

from ..shell.options import FiniteRange
from ..shell.progress import progress
from ..shell.tables import Column, echo, table

# Clocks of up to eight tags, none of whose lines lies near one of another's.
_CLOCKS_HZ = (1000.0, 1400.0, 1790.0, 820.0, 1180.0, 1610.0, 1930.0, 1100.0)
# A piece of signal of this length holds whole frames, groups and, with clocks that are multiples of
# 1 / 3.6 s, whole periods: repeated, it has no break.
_PIECE_SAMPLES, _SAMPLE_RATE_HZ = 45_000_000, 12.5e6
_PIECE_S = _PIECE_SAMPLES / _SAMPLE_RATE_HZ
_SENSORS = (1, 2, 4, 8)
_GROUP_LENGTHS = (63, 125, 625)
# Groups that are read together (as of recordings), and batches that are timed: the lower quartile
# of so many repeats within 10 %. Sums differ by half, as what else the machine does lengthens some
# of them. Along an axis, where groups of long symbols would fill the memory, fewer of both.
_BATCH, _TIMED = 256, 24
_AXIS_BATCH, _AXIS_TIMED = 64, 5
_SINGLE_GROUPS = 64  # of each batch, read once more one by one


@dataclass(frozen=True)
class Setting:
    """What a row measures; ``axis`` is the other key that changes along an axis, or empty."""

    axis: str = ""
    sensors: int = 2
    snapshots: int = 625
    frame_length: int = 720
    symbol_length: int = 64

    @property
    def value(self):
        """Along the axis; of frames, the snapshots per second."""
        value = getattr(self, self.axis)
        return _SAMPLE_RATE_HZ / value if self.axis == "frame_length" else value


# The longest symbol is sent twice per frame; the frame is the same for all, so that only the
# number of subcarriers changes.
_SYMBOLS = Setting("symbol_length", snapshots=250, frame_length=9000)
AXES = {
    "sensors": [Setting("sensors", sensors=n) for n in (1, 2, 4, 8, 16)],
    "snapshots": [Setting("snapshots", snapshots=n) for n in (125, 250, 625, 1250, 2500)],
    "frame_length": [Setting("frame_length", frame_length=n) for n in (7200, 2880, 1440, 720, 360)],
    "symbol_length": [replace(_SYMBOLS, symbol_length=n) for n in (16, 64, 256, 1024, 4096)],
}
LABELS = {
    "sensors": "sensors",
    "snapshots": "snapshots per group",
    "frame_length": "snapshots per second",
    "symbol_length": "samples per symbol",
}
QUANTITIES = {
    "start_s": "start (s)",
    "samples_ms": "samples (ms/s)",
    "group_us": "batches (us/group)",
    "groups_ms": "batches (ms/s)",
}
# Times are wall time of ``gr-wiforce read``, start-up included, processor time of all its threads,
# processor time from samples to tones per second of signal, and processor time from tones to
# readings per group, in batches and one group at a time.
_SIZE = (
    Column("sensors", "sensors"),
    Column("N_g", "snapshots"),
    Column("tones", "tones"),
)
_TIMES = (
    Column(QUANTITIES["samples_ms"], "samples_ms", ".1f"),
    Column(QUANTITIES["group_us"], "group_us", ".0f"),
    Column("single (us/group)", "single_us", ".0f"),
)
_REAL_TIME = Column("x real time", "real_time", ".1f")
COLUMNS = (
    *_SIZE,
    _REAL_TIME,
    Column("wall (s)", "read_s", ".2f"),
    Column("processor (s)", "cpu_s", ".2f"),
    *_TIMES,
)
SCALING = (
    Column("axis", "axis", LABELS.get),
    *_SIZE,
    Column("snapshots/s", "frame_length", lambda n: f"{_SAMPLE_RATE_HZ / n:.0f}"),
    Column("subcarriers", "subcarriers"),
    Column("plan (s)", "plan_s", ".2f"),
    Column(QUANTITIES["start_s"], "start_s", ".2f"),
    *_TIMES,
    Column(QUANTITIES["groups_ms"], "groups_ms", ".2f"),
    _REAL_TIME,
)
GROWTH = (
    Column("along", "axis", LABELS.get),
    Column("time", "quantity", QUANTITIES.get),
    Column("exponent", "exponent", ".2f"),
    Column("at the end", "at_end", ".2f"),
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
def read(as_json, seconds, sensors, scaling, axes):
    """Measure the complete path from a capture's file to readings, and its stages.

    Recordings of 12.5 Msps (ci16_le, in the page cache) hold one to eight sensors, pressed in
    turns. The command is timed with its start-up; samples and groups are timed by themselves, by
    processor time, groups by its lower quartile over batches. A combination that the plan refuses,
    because its groups are too short to separate the tags, is left out.

    With --scaling, one of sensors, snapshots per group, snapshots per second and samples per symbol
    changes at a time, and the exponents by which the times grow are printed.
    """
    if scaling:
        if seconds is not None or sensors:
            raise click.UsageError("--seconds and --sensors do not apply with --scaling")
        settings = [setting for axis in axes or AXES for setting in AXES[axis]]
        rows = _rows(settings, _AXIS_TIMED * _PIECE_S)
        result = {"rows": rows, "growth": growth(rows)}
        echo(
            result,
            as_json,
            lambda _: table(rows, SCALING),
            lambda _: table(result["growth"], GROWTH),
        )
        return
    if axes:
        raise click.UsageError("--axis applies with --scaling only")
    counts = [int(count) for count in sensors] or _SENSORS
    settings = [Setting("", count, snapshots) for count in counts for snapshots in _GROUP_LENGTHS]
    rows = _rows(settings, 60.0 if seconds is None else seconds)
    echo(rows, as_json, lambda _: table(rows, COLUMNS))


def _rows(settings, seconds):
    """The row of each setting, except of those that the plan refuses."""
    with (
        tempfile.TemporaryDirectory(prefix="wiforce-read-") as place,
        progress("measuring", len(settings)) as step,
    ):
        rows = []
        for setting in settings:
            row = measure(setting, Path(place), seconds)
            rows += [] if row is None else [row]
            step(1)
    return rows


def scene_of(setting):
    """The scene of a row, as a mapping."""
    names = [f"sensor{i + 1}" for i in range(setting.sensors)]
    # Presses of the sensors in turns: the first one, the time between two, and how long each lasts.
    turns, noted, clocks_hz = (0.8, 0.3, 0.5), {}, _CLOCKS_HZ
    if setting.axis:
        sounding = {"frame_length": setting.frame_length}
        if setting.axis == "symbol_length":
            sounding |= {"symbol_length": setting.symbol_length, "repetitions": 2}
        room = {"moving_clutter_hz": 0, "mains_hz": None}
        noted = {"sounding": sounding, "environment": room, "reference_s": 0.75}
        # Groups of all lengths have the same recording, whose clocks the shortest can separate.
        shortest = {"snapshots": min(s.snapshots for s in AXES[setting.axis])}
        sensor = {"name": "any", "model": "line-900mhz", "clock_hz": 100}
        proposed = clocks_for(
            {**noted, "phase_group": shortest, "sensors": [sensor]}, setting.sensors
        )
        clocks_hz = [round(hz * _PIECE_S) / _PIECE_S for hz in proposed.clocks_hz]
        share_s = (_PIECE_S - 1.0) / setting.sensors
        turns = 1.0, share_s, 0.5 * share_s
    return {
        **noted,
        "phase_group": {"snapshots": setting.snapshots},
        "sensors": [
            {"name": name, "model": "line-900mhz", "clock_hz": clock_hz}
            for name, clock_hz in zip(names, clocks_hz, strict=False)
        ],
        "simulation": {
            "duration_s": (_PIECE_SAMPLES + setting.frame_length / 2) / _SAMPLE_RATE_HZ,
            "seed": 1,
            "snr_db": 15,
            "static_clutter_db": 50,
            "clock_offset_ppm": 0,
            "clock_drift_ppm_per_s": 0,
            "presses": [
                {
                    "sensor": name,
                    "start_s": turns[0] + turns[1] * i,
                    "rise_s": 0.02,
                    "hold_s": turns[2],
                    "force_n": 4.0,
                    "end_force_n": 5.0,
                    "location_mm": 30.0 + 2 * i,
                }
                for i, name in enumerate(names)
            ],
        },
    }


def _recorded(scene, folder, seconds):
    """The capture of a scene, which the row before may have had as well: a piece, repeated."""
    capture, made = folder / "capture", folder / "made.json"
    # What is sent and received does not depend on the groups.
    sent = json.dumps([scene.get("sounding"), scene["sensors"], scene["simulation"]])
    if made.exists() and made.read_text(encoding="utf-8") == sent:
        return capture
    for path in folder.iterdir():
        path.unlink()
    simulate(load_scene(scene), capture)
    data = capture.with_suffix(".sigmf-data")
    piece = data.read_bytes()
    pieces = int(np.ceil(seconds / _PIECE_S))
    if len(piece) * (pieces - 1) > shutil.disk_usage(folder).free:
        rule = f"must leave room for recordings of {len(piece) * pieces / 1e9:.1f} GB"
        raise click.BadParameter(f"{rule}, got {seconds:g}", param_hint="--seconds")
    with open(data, "ab") as stream:
        for _ in range(pieces - 1):
            stream.write(piece)
    made.write_text(sent, encoding="utf-8")
    return capture


def measure(setting, folder, seconds):
    """The row of a setting, from a recording of some length; None when the plan refuses it."""
    scene = scene_of(setting)
    start = time.process_time()
    try:
        settings = plan(scene)
    except InputError:
        if setting.axis:
            raise  # else an exponent would silently be that of fewer points
        return None
    plan_s = time.process_time() - start
    capture = _recorded(scene, folder, seconds)
    recording = open_capture(capture)
    signal_s = recording.span / recording.sample_rate_hz
    start = time.process_time()
    offset = first_frame(recording, settings.waveform, require_frames(recording, settings.waveform))
    settings = adapted(settings, survey_recording(recording, settings, offset))
    survey_s = time.process_time() - start
    size = (_AXIS_BATCH, _AXIS_TIMED) if setting.axis else (_BATCH, _TIMED)
    samples_s, tones = _time_samples(recording, settings)
    acquisition_s, group_s, single_s = _time_groups(settings, tones, *size)
    groups_s = group_s * signal_s / settings.group_period_s
    row = {
        **asdict(setting),
        "subcarriers": len(settings.waveform.subcarriers),
        "tones": len(settings.table.tones),
        "signal_s": signal_s,
        "plan_s": plan_s,
        "start_s": plan_s + survey_s + acquisition_s,
        "samples_ms": 1e3 * samples_s / signal_s,
        "group_us": 1e6 * group_s,
        "single_us": 1e6 * single_s,
        "groups_ms": 1e3 * groups_s / signal_s,
    }
    if setting.axis:
        # Samples and groups run on a core each.
        return row | {"value": setting.value, "real_time": signal_s / max(samples_s, groups_s)}
    read_s, cpu_s = _time_command(capture, scene)
    return row | {"read_s": read_s, "cpu_s": cpu_s, "real_time": signal_s / read_s}


def _time_command(capture, scene):
    """Wall and processor time of ``gr-wiforce read``."""
    path = capture.with_name("scene.yaml")
    path.write_text(yaml.safe_dump(scene), encoding="utf-8")
    command = [sys.executable, "-c", "from wiforce_app.main import run; raise SystemExit(run())"]
    command += ["read", str(capture), "--scene", str(path), "-o", str(capture) + ".csv"]
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
    piece = _PIECE_SAMPLES // settings.waveform.frame_length // settings.group_length
    start = time.process_time()
    while len(groups := source.read()):
        if sum(map(len, batches)) < piece:
            batches.append(groups)
    return time.process_time() - start, Groups.concatenate(batches)[:piece]


def _time_groups(settings, piece, length, count):
    """Processor time until clocks and reference are known, then of a group in a batch and alone."""
    together, alone, took, acquisition_s = Receiver(settings), Receiver(settings), [], 0.0
    for first in itertools.count(0, length):
        index = first + np.arange(length)
        batch = piece[index % len(piece)].having(index=index)
        known = alone.state == "reading"
        single = [batch[i : i + 1] for i in range(min(length, _SINGLE_GROUPS) * known)]
        pair = _seconds(together, [batch]), _seconds(alone, single)
        alone.process(batch[len(single) :])
        if known:
            took.append((pair[0] / length, pair[1] / len(single)))
        else:
            acquisition_s += pair[0]
        if len(took) == count:
            return acquisition_s, *np.quantile(took, 0.25, axis=0).tolist()


def _seconds(receiver, batches):
    start = time.process_time()
    for batch in batches:
        receiver.process(batch)
    return time.process_time() - start


def growth(rows):
    """Exponents of the times along each axis, by a line through logarithms, and at the end."""
    found = []
    for axis in dict.fromkeys(row["axis"] for row in rows):
        own = [row for row in rows if row["axis"] == axis]
        x = np.log([row["value"] for row in own])
        for quantity in QUANTITIES:
            y = np.log([row[quantity] for row in own])
            slopes = {"exponent": np.polyfit(x, y, 1)[0], "at_end": (np.diff(y) / np.diff(x))[-1]}
            # Without the sign of a zero.
            powers = {name: round(float(slope), 2) + 0.0 for name, slope in slopes.items()}
            found.append({"axis": axis, "quantity": quantity, **powers})
    return found
