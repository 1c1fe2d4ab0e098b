# SPDX-License-Identifier: GPL-3.0-or-later
"""The inversion benchmark: what it prints. No speed is asserted here."""

import json

from command_runs import run_command
from wiforce_app.bench import inversion


def test_bench_inversion_of_one_sensor_gives_a_row_per_noise(monkeypatch, long_run):
    if not long_run:
        for name, value in {"_BATCH": 4000, "_SINGLE": 100, "_CHECKED": 6, "_RUNS": 2}.items():
            monkeypatch.setattr(inversion, name, value)
    done = run_command("bench", "inversion", "--json", "--sensor", "wiforce-900mhz")
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [row["noise_deg"] for row in rows] == [0.2, 1.0]
    for row in rows:
        assert row["sensor"] == "wiforce-900mhz" and row["carrier_mhz"] == 900
        assert row["batch_us"] > 0 and row["single_us"] > 0
        # the mode is reported where it is nearer to the mean than this
        assert row["from_exact_std"] < 0.3
        assert row["within_2_std"] > 0.9 and 0 < row["flagged"] < 1
