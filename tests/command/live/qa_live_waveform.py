# SPDX-License-Identifier: GPL-3.0-or-later
"""A symbol from a file on the air: sent by the reader, seen by the device, read live."""

import subprocess

import numpy as np
from live_runs import FRAMES, GAINS, live_command, rows_of, scene_file
from live_runs import command as run

SECONDS = 4


def test_symbol_from_a_file_is_sent_and_read_live(tmp_path, software_usrp):
    """The process that has the device must be given the symbol, not only its name."""
    n = np.arange(96)
    np.save(tmp_path / "own.npy", np.exp(2j * np.pi * (n**2 / 192 - n / 2)))
    scene = scene_file(
        tmp_path,
        [(1.2, 4.0, 4.0, 45.0), (2.4, 6.0, 6.0, 33.0)],
        700,
        0.4,
        radio={"sample_rate_hz": 2.5e6},
        sounding={"waveform": "own.npy", "frame_length": 400, "repetitions": 3},
        phase_group={"snapshots": 200},
    )
    output = tmp_path / "readings.csv"
    device = software_usrp(scene)
    record = ["--record", tmp_path / "run"]
    command = live_command(f"{device.args},{FRAMES}", scene, *GAINS, *record, "-o", output)
    done = subprocess.run(
        [*command, "--duration", str(SECONDS)], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    rows = rows_of(output)
    pressed = [row for row in rows if row["touch"] == "1" and not row["flags"]]
    places = np.array([float(row["location_mm"]) for row in pressed])
    forces = np.array([float(row["force_n"]) for row in pressed])
    steady = (np.abs(forces - 4) < 0.3) & (np.abs(places - 45) < 0.5)
    steady |= (np.abs(forces - 6) < 0.3) & (np.abs(places - 33) < 0.5)
    assert len(pressed) > 20 and steady.sum() > 0.8 * len(pressed)
    # What was recorded holds the symbol.
    (tmp_path / "own.npy").unlink()
    status, out, said = run("read", tmp_path / "run")
    assert status == 0, said
    assert out.count("\n") >= len(rows) - 2
