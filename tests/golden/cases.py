# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases whose readings are stored: shipped scenes, lost samples, and faulty streams."""

import json
from pathlib import Path

import faults
import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from gnuradio.wiforce.io.readings import SurfaceReading
from gnuradio.wiforce.receiver.snapshot_reader import SnapshotReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from wiforce_app.read.recordings import read_capture

FOLDER = Path(__file__).parent
SCENES = sorted(path.stem for path in (FOLDER / "scenes").glob("*.yaml"))
TRACKED = ("demo", "fingertip", "paper_900", "tabletop_two", "two_sensors")
# Scenes short enough for every run of the tests.
QUICK = (
    "distance_50cm",
    "naive_clocks",
    "own_symbol",
    "packets",
    "surface_two_strips",
    "tabletop",
    "tabletop_two",
)
NUMBERS = (
    "time_s",
    "force_n",
    "force_std_n",
    "location_mm",
    "location_std_mm",
    "phase1_deg",
    "phase2_deg",
    "snr_db",
)
ON_SURFACE = ("y_mm", "y_std_mm")
SEQUENCES = range(6)
# Gaps of a capture: (first sample lost, samples lost), counted on the device.
GAPS = ((9_000_123, 700), (11_700_000, 450_000), (14_000_000, 37))


def columns(readings):
    """Readings as arrays: unknown numbers are NaN, an unknown touch is -1."""
    table = {
        name: np.array([np.nan if (v := getattr(r, name)) is None else v for r in readings], float)
        for name in NUMBERS
    }
    if any(isinstance(r, SurfaceReading) for r in readings):
        for name in ON_SURFACE:
            values = [getattr(r, name, None) for r in readings]
            table[name] = np.array([np.nan if v is None else v for v in values], float)
    table["touch"] = np.array([-1 if r.touch is None else r.touch for r in readings])
    table["sensor"] = np.array([r.sensor for r in readings])
    table["flags"] = np.array([" ".join(sorted(r.flags)) for r in readings])
    return table


def scene_readings(name, folder, tracked=False, gaps=()):
    """Readings of a stored scene's capture, from which samples may have been lost."""
    scene = load_scene(FOLDER / "scenes" / f"{name}.yaml")
    capture = Path(folder) / name
    if scene.packets:
        simulate(scene, capture, overwrite=True)
        reader = SnapshotReader(open_snapshots(capture.with_suffix(".npz")), scene)
        return [reading for batch in reader for reading in batch]
    if not capture.with_suffix(".sigmf-meta").exists():
        simulate(scene, capture)
    if gaps:
        capture = with_gaps(capture, gaps)
    return read_capture(open_capture(capture), scene, tracked=tracked)


def with_gaps(capture, gaps):
    """A copy of a capture without the samples of some stretches, as its metadata says."""
    meta = json.loads(capture.with_suffix(".sigmf-meta").read_text())
    codes = np.fromfile(capture.with_suffix(".sigmf-data"), "<i2").reshape(-1, 2)
    parts, begin = [], 0
    for start, lost in (*gaps, (len(codes), 0)):
        parts.append((begin, codes[begin:start]))
        begin = start + lost
    starts = np.cumsum([0] + [len(part) for _, part in parts[:-1]]).tolist()
    first = meta["captures"][0]
    meta["captures"] = [
        {**first, "core:sample_start": start, "core:global_index": index}
        for start, (index, _) in zip(starts, parts, strict=True)
    ]
    meta["global"].pop("core:sha512", None)
    copy = capture.with_name(f"{capture.name}-gaps")
    copy.with_suffix(".sigmf-meta").write_text(json.dumps(meta))
    np.concatenate([part for _, part in parts]).tofile(copy.with_suffix(".sigmf-data"))
    return copy


def fault_readings(name, folder):
    """Readings of a press after a fault of that name, or after the faults of a sequence."""
    press = Path(folder) / "press"
    if not press.with_suffix(".sigmf-data").exists():
        simulate(load_scene(faults.SCENE), press)
    codes = np.fromfile(press.with_suffix(".sigmf-data"), "<i2").reshape(-1, 2)
    if name.startswith("sequence"):
        seed, earliest = int(name.removeprefix("sequence")), 0
        chosen = faults.random_faults(seed, faults.FAULTS)
    else:
        seed, earliest = 1, faults.STARTED
        chosen = [fault for fault in faults.FAULTS if fault.__name__ == name]
    stream = faults.faulty(codes, np.random.default_rng(seed), chosen, earliest)
    return faults.read(stream)[0]


def all_cases():
    """What makes the readings of each case, given a folder for captures, by its name."""
    cases = {name: (scene_readings, name) for name in SCENES}
    cases |= {f"{name}-tracked": (scene_readings, name, True) for name in TRACKED}
    cases["demo-gaps"] = (scene_readings, "demo", False, GAPS)
    streams = [fault.__name__ for fault in faults.FAULTS] + [f"sequence{i}" for i in SEQUENCES]
    return cases | {name: (fault_readings, name) for name in streams}


def make(case, folder):
    """Columns of a case's readings."""
    function, name, *more = all_cases()[case]
    return columns(function(name, folder, *more))


def stored(case):
    """Columns of a case's readings as they were stored."""
    with np.load(FOLDER / "readings" / f"{case}.npz") as file:
        return dict(file)
