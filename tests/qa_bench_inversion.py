# SPDX-License-Identifier: GPL-3.0-or-later
"""The inversion benchmark: what it prints. No speed is asserted here."""

import json
import subprocess


def test_bench_inversion_of_one_sensor_gives_a_row_per_noise():
    command = "gr-wiforce bench inversion --json --sensor wiforce-900mhz"
    done = subprocess.run(command.split(), capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [row["noise_deg"] for row in rows] == [0.2, 1.0]
    for row in rows:
        assert row["sensor"] == "wiforce-900mhz" and row["carrier_mhz"] == 900
        assert row["batch_us"] > 0 and row["single_us"] > 0
        # the mode is reported where it is nearer to the mean than this
        assert row["from_exact_std"] < 0.3
        assert row["within_2_std"] > 0.9 and 0 < row["flagged"] < 1
