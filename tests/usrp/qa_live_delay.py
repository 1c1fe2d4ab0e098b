# SPDX-License-Identifier: GPL-3.0-or-later
"""The delay of live readings, measured by the command; no delay is asserted tightly here."""

import json
import subprocess

SHORTEST_S = 10.08e-3  # a reading waits for the group after it


def test_bench_live_measures_delay_of_readings_and_presses():
    command = ["gr-wiforce", "bench", "live", "--json", "--msps", "1.25", "--presses", "2"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert run.returncode == 0, run.stderr
    (row,) = json.loads(run.stdout)
    assert row["msps"] == 1.25 and abs(row["group_ms"] - 10.08) < 1e-6
    assert row["readings"] > 100 and row["presses"] == 2
    # What a busy machine adds to it is not limited here.
    assert row["delay_ms"] > 1e3 * SHORTEST_S - 3
    assert row["delay_ms"] <= row["delay_95_ms"] <= row["delay_99_ms"]
    assert row["press_ms"] > 1e3 * SHORTEST_S - 3 and row["cores"] > 0
