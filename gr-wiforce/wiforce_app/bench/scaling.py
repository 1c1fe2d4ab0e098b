# SPDX-License-Identifier: GPL-3.0-or-later
"""How the receiver's work grows with sensors, group length, snapshot rate and subcarriers."""

import json
import os
import platform
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.clocks.proposals import clocks_for
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

from ..shell.markdown import markdown_table
from ..shell.progress import progress
from .report import Column, head_and_cells

# All rows have a piece of signal of this length, which holds whole frames, groups and, with clocks
# that are multiples of 1 / 3.6 s, whole periods: repeated, it has no break.
_PIECE_SAMPLES, _SAMPLE_RATE_HZ = 45_000_000, 12.5e6
_PIECE_S = _PIECE_SAMPLES / _SAMPLE_RATE_HZ
# Groups that are read together. Recordings are read in batches of 256, but a piece of long groups
# holds fewer, and all rows are to be alike.
_BATCH = 64
# Each time is the median of so many.
_REPEATS = 5
_REFERENCE_S, _FIRST_PRESS_S = 0.75, 1.0


@dataclass(frozen=True)
class Setting:
    """What a row measures.

    Attributes
    ----------
    axis : str
        Which of the other keys changes along the row's axis.
    sensors, snapshots : int
        S and N_g.
    frame_length, symbol_length : int
        Samples.
    """

    axis: str
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
    "group_us": "groups (us/group)",
    "groups_ms": "groups (ms/s)",
}
COLUMNS = (
    Column("axis", "axis", LABELS.get),
    Column("sensors", "sensors"),
    Column("N_g", "snapshots"),
    Column("snapshots/s", "frame_length", lambda n: f"{_SAMPLE_RATE_HZ / n:.0f}"),
    Column("subcarriers", "subcarriers"),
    Column("tones", "tones"),
    Column("plan (s)", "plan_s", ".2f"),
    Column(QUANTITIES["start_s"], "start_s", ".2f"),
    Column(QUANTITIES["samples_ms"], "samples_ms", ".1f"),
    Column(QUANTITIES["group_us"], "group_us", ".0f"),
    Column(QUANTITIES["groups_ms"], "groups_ms", ".2f"),
    Column("x real time", "real_time", ".1f"),
)
GROWTH = (
    Column("along", "axis", LABELS.get),
    Column("time", "quantity", QUANTITIES.get),
    Column("exponent", "exponent", ".2f"),
    Column("at the end", "at_end", ".2f"),
)


def measure(axes, folder=None):
    """Rows along some of the AXES, and how they grow, with the machine that they depend on.

    Recordings of up to 200 MB are made in the folder, the system's temporary one by default.
    """
    settings = [setting for axis in axes for setting in AXES[axis]]
    with (
        tempfile.TemporaryDirectory(prefix="wiforce-scaling-", dir=folder) as place,
        progress("measuring", len(settings)) as step,
    ):
        rows = []
        for setting in settings:
            rows.append(_measure(setting, Path(place)))
            step(1)
    return {"machine": _machine(), "rows": rows, "growth": growth(rows)}


def _machine():
    """What the times depend on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        model = platform.machine()
    return {"processor": model, "cores": len(os.sched_getaffinity(0)), "numpy": np.__version__}


def scene_of(setting):
    """The scene of a row, as a mapping."""
    sounding = {"frame_length": setting.frame_length}
    if setting.axis == "symbol_length":
        sounding |= {"symbol_length": setting.symbol_length, "repetitions": 2}
    names = [f"sensor{i + 1}" for i in range(setting.sensors)]
    room = {"moving_clutter_hz": 0, "mains_hz": None}
    # Groups of all lengths have the same recording, whose clocks the shortest can separate.
    shortest = {"snapshots": min(s.snapshots for s in AXES[setting.axis])}
    sensor = {"name": "any", "model": "line-900mhz", "clock_hz": 100}
    frame = {"sounding": sounding, "environment": room, "reference_s": _REFERENCE_S}
    clocks = clocks_for({**frame, "phase_group": shortest, "sensors": [sensor]}, setting.sensors)
    return {
        **frame,
        "phase_group": {"snapshots": setting.snapshots},
        "sensors": [
            {**sensor, "name": name, "clock_hz": round(clock_hz * _PIECE_S) / _PIECE_S}
            for name, clock_hz in zip(names, clocks.clocks_hz, strict=True)
        ],
        "simulation": {
            "duration_s": (_PIECE_SAMPLES + setting.frame_length / 2) / _SAMPLE_RATE_HZ,
            "seed": 1,
            "snr_db": 15,
            "static_clutter_db": 50,
            "clock_offset_ppm": 0,
            "clock_drift_ppm_per_s": 0,
            "presses": _presses(names),
        },
    }


def _presses(names):
    """One press of each sensor, in turns."""
    share_s = (_PIECE_S - _FIRST_PRESS_S) / len(names)
    return [
        {
            "sensor": name,
            "start_s": _FIRST_PRESS_S + share_s * i,
            "rise_s": 0.02,
            "hold_s": 0.5 * share_s,
            "force_n": 4.0,
            "location_mm": 30.0 + i,
        }
        for i, name in enumerate(names)
    ]


def _recorded(scene, folder):
    """The recording of a scene, which the row before may have had as well."""
    capture, made = folder / "capture", folder / "made.json"
    # What is sent and received does not depend on the groups.
    sent = json.dumps({key: scene[key] for key in ("sounding", "sensors", "simulation")})
    if not made.exists() or made.read_text(encoding="utf-8") != sent:
        made.unlink(missing_ok=True)
        for path in folder.glob("capture*"):
            path.unlink()
        simulate(load_scene(scene), capture)
        made.write_text(sent, encoding="utf-8")
    return open_capture(capture)


def _measure(setting, folder):
    """The row of a setting."""
    scene = scene_of(setting)
    recording = _recorded(scene, folder)
    start = time.process_time()
    settings = plan(scene)
    plan_s = time.process_time() - start
    start = time.process_time()
    reader = RecordingReader(recording, settings, 0)
    survey_s = time.process_time() - start
    samples_s, groups = _time_samples(recording, reader.plan)
    acquisition_s, group_s = _time_groups(reader.plan, groups)
    groups_s = group_s * _PIECE_S / reader.plan.group_period_s
    return {
        "setting": asdict(setting),
        "value": setting.value,
        "subcarriers": len(reader.plan.waveform.subcarriers),
        "tones": len(reader.plan.table.tones),
        "plan_s": plan_s,
        "start_s": plan_s + survey_s + acquisition_s,
        "samples_ms": 1e3 * samples_s / _PIECE_S,
        "group_us": 1e6 * group_s,
        "groups_ms": 1e3 * groups_s / _PIECE_S,
        # Samples and groups run on a core each.
        "real_time": _PIECE_S / max(samples_s, groups_s),
    }


def _time_samples(recording, settings):
    """Processor time from a piece's samples to its tones, and these."""
    took = []
    for _ in range(_REPEATS):
        source, batches = RecordingReader(recording, settings, 0, survey=False).source, []
        start = time.process_time()
        while len(groups := source.read()):
            batches.append(groups)
        took.append(time.process_time() - start)
    return float(np.median(took)), Groups.concatenate(batches)


def _time_groups(settings, piece):
    """Processor time until clocks and reference are known, and of a group in a batch after this."""
    receiver = Receiver(settings)
    start = time.process_time()
    first = 0
    while not receiver.process(piece.having(index=piece.index + first)):
        first += len(piece)
    acquisition_s = time.process_time() - start
    first += len(piece)
    took = []
    for _ in range(_REPEATS):
        copies = -(-_BATCH // len(piece))
        batch = [piece.having(index=piece.index + first + i * len(piece)) for i in range(copies)]
        first += copies * len(piece)
        groups = Groups.concatenate(batch)
        start = time.process_time()
        receiver.process(groups)
        took.append((time.process_time() - start) / len(groups))
    return acquisition_s, float(np.median(took))


def growth(rows):
    """Exponents of the times along each axis, by a straight line through all logarithms.

    ``at_end`` is that of the last two points.
    """
    found = []
    for axis in AXES:
        own = [row for row in rows if row["setting"]["axis"] == axis]
        if len(own) < 2:
            continue
        x = np.log([row["value"] for row in own])
        for quantity in QUANTITIES:
            y = np.log([row[quantity] for row in own])
            slopes = {"exponent": np.polyfit(x, y, 1)[0], "at_end": (np.diff(y) / np.diff(x))[-1]}
            # Without the sign of a zero.
            powers = {name: round(float(slope), 2) + 0.0 for name, slope in slopes.items()}
            found.append({"axis": axis, "quantity": quantity, **powers})
    return found


def table(result):
    """Rows and growth as tables in Markdown."""
    rows = [{**row, **row["setting"]} for row in result["rows"]]
    machine = result["machine"]
    return "\n\n".join(
        [
            f"{machine['processor']}, {machine['cores']} cores, NumPy {machine['numpy']}",
            markdown_table(*head_and_cells(rows, COLUMNS)),
            markdown_table(*head_and_cells(result["growth"], GROWTH)),
        ]
    )
