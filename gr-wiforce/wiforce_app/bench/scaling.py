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

from ..shell.markdown import markdown_table
from ..shell.progress import progress

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


def measure(axes, folder=None, kept=None):
    """Rows of some axes.

    Parameters
    ----------
    axes : sequence of str
        Keys of AXES.
    folder : str or Path, optional
        For recordings, which have up to 200 MB; the system's temporary folder by default.
    kept : Path, optional
        Rows are added to this file; those that it has already are not measured again.

    Returns
    -------
    dict
        ``machine`` and ``rows``; what each row holds is in ``table``.
    """
    result = _read(kept) or {"machine": _machine(), "rows": []}
    known = [row["setting"] for row in result["rows"]]
    wanted = [s for axis in axes for s in AXES[axis]]
    missing = [s for s in wanted if asdict(s) not in known]
    with (
        tempfile.TemporaryDirectory(prefix="wiforce-scaling-", dir=folder) as place,
        progress("measuring", len(missing)) as step,
    ):
        for setting in missing:
            result["rows"].append(_measure(setting, Path(place)))
            if kept is not None:
                kept.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            step(1)
    order = [asdict(s) for s in wanted]
    rows = [row for row in result["rows"] if row["setting"] in order]
    rows.sort(key=lambda row: order.index(row["setting"]))
    return {**result, "rows": rows, "growth": growth(rows)}


def _read(kept):
    """Rows that were measured before; None without any."""
    from gnuradio.wiforce.errors import InputError

    if kept is None or not kept.exists():
        return None
    try:
        result = json.loads(kept.read_text(encoding="utf-8"))
        result = {key: result[key] for key in ("machine", "rows")}
        for row in result["rows"]:
            Setting(**row["setting"])
            _ = [row[key] + 0 for key in QUANTITIES]
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise InputError(kept, "must be a file that bench read --scaling has written") from error
    return result


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
    from gnuradio.wiforce.planning.proposed_clocks import clocks_for

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
    from gnuradio.wiforce.io.capture import open_capture
    from gnuradio.wiforce.scene import load_scene
    from gnuradio.wiforce.simulation.simulator import simulate

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
    from gnuradio.wiforce.planning.plan import plan
    from gnuradio.wiforce.recording import RecordingReader

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
    from gnuradio.wiforce.estimation.groups import Groups
    from gnuradio.wiforce.recording import RecordingReader

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
    from gnuradio.wiforce.estimation.groups import Groups
    from gnuradio.wiforce.receiver import Receiver

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
    """Exponents of the times along each axis.

    Parameters
    ----------
    rows : sequence of dict
        Of ``measure``.

    Returns
    -------
    list of dict
        ``axis``, ``quantity``, ``exponent`` by a straight line through all logarithms, and
        ``at_end`` by the last two points.

    Examples
    --------
    >>> def row(n):
    ...     times = {"start_s": 1.0, "samples_ms": n**2, "group_us": n, "groups_ms": n}
    ...     return {"setting": {"axis": "sensors"}, "value": n, **times}
    >>> [each["exponent"] for each in growth([row(n) for n in (1, 2, 4)])]
    [0.0, 2.0, 1.0, 1.0]
    """
    found = []
    for axis in AXES:
        own = [row for row in rows if row["setting"]["axis"] == axis]
        if len(own) < 2:
            continue
        x = np.log([row["value"] for row in own])
        for quantity in QUANTITIES:
            y = np.log([row[quantity] for row in own])
            exponent = round(float(np.polyfit(x, y, 1)[0]), 2)
            *_, at_end = [b / a for a, b in zip(np.diff(x), np.diff(y), strict=True)]
            found.append(
                {
                    "axis": axis,
                    "quantity": quantity,
                    "exponent": exponent + 0.0,
                    "at_end": round(float(at_end), 2) + 0.0,
                }
            )
    return found


def table(result):
    """Rows and growth as tables in Markdown."""
    head = ["axis", "sensors", "N_g", "snapshots/s", "subcarriers", "tones", "plan (s)"]
    head += [*QUANTITIES.values(), "x real time"]
    cells = []
    for row in result["rows"]:
        setting = Setting(**row["setting"])
        cells.append(
            [
                LABELS[setting.axis],
                str(setting.sensors),
                str(setting.snapshots),
                f"{_SAMPLE_RATE_HZ / setting.frame_length:.0f}",
                str(row["subcarriers"]),
                str(row["tones"]),
                f"{row['plan_s']:.2f}",
                f"{row['start_s']:.2f}",
                f"{row['samples_ms']:.1f}",
                f"{row['group_us']:.0f}",
                f"{row['groups_ms']:.2f}",
                f"{row['real_time']:.1f}",
            ]
        )
    powers = [
        [LABELS[each["axis"]], QUANTITIES[each["quantity"]], f"{each['exponent']:.2f}"]
        + [f"{each['at_end']:.2f}"]
        for each in result["growth"]
    ]
    machine = result["machine"]
    return "\n\n".join(
        [
            f"{machine['processor']}, {machine['cores']} cores, NumPy {machine['numpy']}",
            markdown_table(head, cells).rstrip("\n"),
            markdown_table(["along", "time", "exponent", "at the end"], powers).rstrip("\n"),
        ]
    )
