# SPDX-License-Identifier: GPL-3.0-or-later
"""The delay of live readings, measured by the command; no delay is asserted tightly here."""

import json
import subprocess

import pytest
from wiforce_app.bench.live import delays_s

SHORTEST_S = 10.08e-3  # a reading waits for the group after it


def test_delays_are_counted_from_when_the_device_sent_the_sample():
    """A device that is late, or sends in bursts, must not count as a delay of the reader."""
    sent = [(5.00, 100.0), (5.01, 100.2), (5.02, 100.21), (5.03, 100.5)]
    readings = [(100.25, 5.005), (100.30, 5.015), (100.30, 4.9), (101.0, 5.03)]
    assert delays_s(readings, sent, 0.005) == pytest.approx([0.05, 0.09])
    assert delays_s(readings, sent, 0.006) == pytest.approx([0.04, -0.2])


@pytest.mark.long
def test_bench_live_measures_delay_of_readings_and_presses():
    command = ["gr-wiforce", "bench", "live", "--json", "--msps", "1.25", "--presses", "2"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    (row,) = json.loads(run.stdout)
    assert row["msps"] == 1.25 and abs(row["group_ms"] - 10.08) < 1e-6
    assert row["readings"] > 50 and row["presses"] == 2
    # What a busy machine adds to it is not limited here.
    assert row["delay_ms"] > 1e3 * SHORTEST_S - 3
    assert row["delay_ms"] <= row["delay_95_ms"] <= row["delay_99_ms"]
    assert 0 < row["work_ms"] < row["delay_ms"] and row["speed"] > 0
    assert row["press_ms"] > 1e3 * SHORTEST_S - 3 and row["cores"] > 0
