# SPDX-License-Identifier: GPL-3.0-or-later
"""Live runs through SoapySDR, on the software N210 by way of SoapyUHD."""

import json

import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from live_runs import (
    GAINS,
    SLOW,
    SLOW_GROUP_S,
    live,
    rows_of,
    scene_file,
)

SOAPY = ["--driver", "soapy"]
LOST = 3630


def column(rows, name):
    return np.array([float(row[name] or "nan") for row in rows])


def test_soapy_overflow_is_one_gap_of_the_samples_lost(software_usrp, tmp_path):
    scene = scene_file(tmp_path, [(0.7, 4.0, 4.0, 45.0)], 400, 0.4, **SLOW)
    device = software_usrp(scene, faults=[f"+1.2 overflow {LOST}"])
    output = tmp_path / "soapy.csv"
    options = [*SOAPY, *GAINS, "-o", output, "--record", tmp_path / "soapy", "--duration", 1.9]
    with live(f"driver=uhd,{device.args}", scene, *options) as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    rows = rows_of(output)
    assert f"1 gap, {LOST} samples lost" in said.splitlines()[-1]
    # In one group, or in two where it lies between them: streams start at another time each.
    assert sum("gap" in row["flags"] for row in rows) in (1, 2)
    assert np.allclose(column(rows, "time_s"), SLOW_GROUP_S * (np.arange(len(rows)) + 0.5))
    assert all(row["time_utc"] for row in rows)
    capture = open_capture(tmp_path / "soapy")
    assert capture.span - capture.samples == LOST and len(capture.segments) == 2
    fields = json.loads((tmp_path / "soapy.sigmf-meta").read_text())["global"]
    assert "N210" in fields["core:hw"] and "soapy" not in fields["core:hw"]
    assert fields["wiforce:rx_gain_db"] == fields["wiforce:tx_gain_db"] == 15
