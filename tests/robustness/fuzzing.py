# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of input, the command that each is given to, and broken inputs in one process.

    python3 fuzzing.py KIND COUNT

works in the current folder and prints what is wrong, a line each.
"""

import contextlib
import io
import signal
import sys
import time
from pathlib import Path

import numpy as np
import yaml
from gnuradio.wiforce import sensor as sensors
from mutations import mutated, mutated_samples
from wiforce_app.main import main

LIMIT_S = 10
LIMIT_BYTES = 1 << 30

SCENE = {
    "sensors": [{"name": "arm", "model": "line-900mhz", "off_reflection": [0.05, 0.0]}],
    "radio": {"center_frequency_hz": 900e6, "sample_rate_hz": 12.5e6},
    "sounding": {"waveform": "repeated", "frame_length": 720},
    "phase_group": {"snapshots": 125},
    "environment": {"moving_clutter_hz": 0, "reader_clock": "shared"},
    "reference_s": 0.05,
    "simulation": {
        "duration_s": 0.2,
        "seed": 4,
        "snr_db": 25,
        "static_clutter_db": 40,
        "clock_offset_ppm": 20,
        "presses": [
            {
                "sensor": "arm",
                "start_s": 0.1,
                "rise_s": 0.01,
                "hold_s": 0.06,
                "force_n": 4.0,
                "end_force_n": 5.0,
                "location_mm": 37.0,
            }
        ],
    },
}


class Hang(BaseException):
    """The command took longer than LIMIT_S; no `except Exception` may catch this."""


class Kind:
    """One kind of input: its sound original, and what to call with a broken version of it.

    Parameters
    ----------
    name : str
    original : bytes
    file : str
        Name under which a broken version is put into the working folder.
    arguments : sequence of str
        Of the ``gr-wiforce`` command, run in the working folder.
    """

    def __init__(self, name, original, file, arguments):
        self.name, self.original, self.file, self.arguments = name, original, file, arguments

    def broken(self, seed):
        """The broken version of a seed."""
        rng = np.random.default_rng([seed, len(self.original)])
        return (mutated_samples if self.name == "samples" else mutated)(self.original, rng)


def kinds(folder):
    """Every kind by name; what they need is put into ``folder``."""
    folder = Path(folder)
    scene = yaml.safe_dump(SCENE).encode()
    (folder / "scene.yaml").write_bytes(scene)
    assert main(["simulate", str(folder / "scene.yaml"), str(folder / "capture")]) == 0
    line = sensors.load_sensor("line-900mhz")
    table = sensors.measure_vna(line, [20.0, 40.0, 60.0], np.linspace(1, 8, 6), 0.2)
    sensors.write_vna_csv(table, folder / "vna.csv")
    assert main(["calibrate", str(folder / "vna.csv"), "-o", str(folder / "arm.yaml")]) == 0
    index, first = _touchstone(table, folder)
    phases = b"phase1_deg,phase2_deg,time_s,sensor,location_mm\n"
    phases += b"".join(
        b"%d,%d,%g,arm,%s\n" % (100 - i, 90 + i, i / 28, b"40" if i % 3 else b"") for i in range(9)
    )
    (folder / "phases.csv").write_bytes(phases)
    read = ["read", "--scene", "scene.yaml", "-o", "out.csv"]
    data = (folder / "capture.sigmf-data").read_bytes()
    (folder / "x.sigmf-data").symlink_to("capture.sigmf-data")
    calibrate = ["calibrate", "-o", "out.yaml", "--form", "cubic"]
    touchstone = [*calibrate, "--frequency-hz", "900e6"]
    invert = ["invert", "-o", "out.jsonl", "--sensor"]
    found = [
        Kind("scene", scene, "x.yaml", ["plan", "x.yaml"]),
        Kind(
            "sensor",
            (folder / "arm.yaml").read_bytes(),
            "y.yaml",
            [*invert, "y.yaml", "phases.csv"],
        ),
        Kind("vna", (folder / "vna.csv").read_bytes(), "x.csv", [*calibrate, "x.csv"]),
        Kind("index", index, "i.csv", [*touchstone, "i.csv"]),
        Kind("touchstone", first, "00.s2p", [*touchstone, "index.csv"]),
        Kind("phases", phases, "p.csv", [*invert, "wiforce-900mhz", "p.csv"]),
        Kind(
            "metadata",
            (folder / "capture.sigmf-meta").read_bytes(),
            "x.sigmf-meta",
            [*read, "x"],
        ),
        Kind("samples", data, "x.bin", [*read, "x.bin", "--datatype", "ci16_le"]),
    ]
    return {kind.name: kind for kind in found}


def _touchstone(table, folder):
    """An index of Touchstone files of a table's presses, and the first of them."""
    presses = sorted({(f, str(p)) for f, p in zip(table.force_n, table.location_mm, strict=True)})
    index = ["file,force_n,location_mm"]
    for number, (force, place) in enumerate(presses):
        here = (table.force_n == force) & (table.location_mm.astype(str) == place)
        angles = [table.phase_deg[here & (table.port == port)][0] for port in (1, 2)]
        cells = " ".join(f"0.9 {a:.3f} 0.01 0 0.01 0 0.9 {b:.3f}" for a, b in [angles])
        lines = [f"{f} {cells}" for f in (800, 900, 1000)]
        (folder / f"{number:02d}.s2p").write_text("# MHz S MA R 50\n" + "\n".join(lines) + "\n")
        index.append(f"{number:02d}.s2p,{force:g},{'' if place == 'nan' else place}")
    text = "\n".join(index) + "\n"
    (folder / "index.csv").write_text(text)
    return text.encode(), (folder / "00.s2p").read_bytes()


def call(arguments):
    """The command's entry function with a deadline: (exit status, standard error, seconds)."""

    def expired(signum, frame):
        raise Hang(f"{arguments}: still running after {LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, expired)
    left = signal.alarm(LIMIT_S)
    said, began = io.StringIO(), time.monotonic()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            status = main(arguments)
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.alarm(left)
    return status, said.getvalue(), time.monotonic() - began


def fault_of(status, said):
    """What is wrong with how a command ended, None when nothing is."""
    if status not in (0, 2):
        return f"exit {status}: {said.strip()[-300:]}"
    if "Traceback" in said:
        return f"traceback: {said.strip()[-300:]}"
    complaints = [
        line for line in said.splitlines() if "warning" not in line and "frames begin" not in line
    ]
    if status == 2 and len(complaints) != 1:
        return f"not one line: {said[:300]!r}"
    return None


def check(kind, data, told):
    """What is wrong with how a kind's command takes this input, None when nothing is."""
    Path(kind.file).write_bytes(data)
    try:
        status, said, _ = call(kind.arguments)
    except Hang as hang:
        return f"{told}: {hang}"
    fault = fault_of(status, said)
    return f"{told}: {fault}" if fault else None


def peak_memory():
    """Most resident memory this process has held, in bytes.

    getrusage would count that of the process which started this one as well: what a process held
    before it became another program is counted to it.
    """
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line for line in status.splitlines() if "VmHWM" in line).split()[1])


def run(name, count):
    """Gives a command its sound input and so many broken ones; prints what is wrong."""
    with contextlib.redirect_stdout(io.StringIO()):
        kind = kinds(".")[name]
    inputs = [("the original", kind.original)]
    inputs.extend((f"{name} {seed}", kind.broken(seed)) for seed in range(count))
    for told, data in inputs:
        fault = check(kind, data, told)
        if fault:
            print(" ".join(fault.split()), flush=True)
    peak = peak_memory()
    if peak > LIMIT_BYTES:
        print(f"{name}: took {peak >> 20} MB of memory")


if __name__ == "__main__":
    run(sys.argv[1], int(sys.argv[2]))
