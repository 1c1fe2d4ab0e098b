# SPDX-License-Identifier: GPL-3.0-or-later
"""The speed benchmark: every row checked against double precision, and what it prints.

No speed is asserted here: that is what the benchmark is for.
"""

import json
import subprocess

import numpy as np
import pytest
from wiforce_app.bench.chains import CHAINS
from wiforce_app.bench.recording import reference_tones, tone_weights, write_recording
from wiforce_app.bench.speed import Row, Worker, _check, _interval

COMPARED = {"stock-tuned", "stock-default", "ceiling-file-source", "ceiling-read"}
ROW_KEYS = {
    "name",
    "tones",
    "pinned",
    "msps",
    "spread",
    "over_stock_tuned",
    "over_stock_default",
    "of_file_source_ceiling",
    "of_read_bandwidth",
    "peak_memory_mb",
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording"), 2_000_000)


@pytest.mark.parametrize("name", [n for n in CHAINS if not n.startswith("ceiling")])
def test_every_chain_gives_the_tones_of_the_plain_reference(recording, name):
    weights = tone_weights(4)
    made = CHAINS[name](recording, weights)
    made.run()
    reference = reference_tones(recording, weights)
    _check(made.tones, reference)


def test_tones_that_are_off_are_refused(recording):
    reference = reference_tones(recording, tone_weights(4))
    wrong = reference.copy()
    wrong[1, 2, 3] += 2e-5 * np.abs(reference).max()
    with pytest.raises(ValueError, match="off"):
        _check(wrong, reference)
    with pytest.raises(ValueError, match="2 groups instead of 4"):
        _check(reference[:2], reference)
    with pytest.raises(ValueError, match="off"):
        _check(np.full_like(reference, np.nan), reference)


def test_a_chain_that_fails_ends_the_bench_with_its_name(recording):
    worker = Worker(Row("odd", "stream-fc32", np.ones((2, 7))), recording, None)
    try:
        with pytest.raises(RuntimeError, match="odd: "):
            worker.run("wall")
    finally:
        worker.close()


def test_the_interval_holds_the_median():
    assert _interval(np.arange(9)[::-1]) == (1, 7)  # 96 % for nine runs
    assert _interval(np.arange(3)) == (0, 2)


@pytest.mark.long
def test_rows_as_json():
    command = "gr-wiforce bench speed --json --runs 3 --megabytes 20"
    done = subprocess.run(
        [*command.split(), "--only", "file-sc16"], capture_output=True, text=True, timeout=110
    )
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert {row["name"] for row in result["rows"]} == COMPARED | {"file-sc16"}
    for row in result["rows"]:
        assert set(row) == ROW_KEYS
        low, high = row["spread"]
        assert 0 < low <= row["msps"] <= high
        assert row["peak_memory_mb"] > 10
    by_name = {(row["name"], row["pinned"]): row for row in result["rows"]}
    assert {pinned for _, pinned in by_name} == {True, False}
    for pinned in (True, False):
        assert by_name["stock-tuned", pinned]["over_stock_tuned"] == 1
        assert by_name["ceiling-read", pinned]["of_read_bandwidth"] == 1
