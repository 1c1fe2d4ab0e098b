# SPDX-License-Identifier: GPL-3.0-or-later
"""What is on disk while `read` runs, when it is killed, and whatever way the samples take."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import pytest
from machine import rows_in, wait_until
from press_capture import GROUP

READ = ("--scene", "scene.yaml")
KILLS, LONG_KILLS = 3, 100


@contextmanager
def following(sandbox, name, output, *options):
    with subprocess.Popen(
        ["gr-wiforce", "read", name, *READ, "--follow", "-o", output, *options],
        cwd=sandbox.folder,
        stderr=subprocess.PIPE,
        text=True,
    ) as reader:
        try:
            yield reader
        finally:
            reader.kill()


def counted(summary):
    """Groups in all, usable, flagged and lost, of a summary line."""
    found = [
        re.search(rf"(\d+) {words}", summary)
        for words in ("groups", "usable", "reference", "while pressing", "doubtful", "lost")
    ]
    groups, clear, *flagged, lost = (0 if each is None else int(each[1]) for each in found)
    return groups, clear, sum(flagged), lost


def test_a_growing_capture_is_read_as_it_grows_and_as_when_it_is_whole(sandbox, readings):
    data = (sandbox.folder / "press.sigmf-data").read_bytes()
    shutil.copy(sandbox.folder / "press.sigmf-meta", sandbox.folder / "grows.sigmf-meta")
    output, count = sandbox.folder / "grows.csv", readings.count("\n")
    with open(sandbox.folder / "grows.sigmf-data", "wb", buffering=0) as recording:
        recording.write(data[:1003])  # ends inside a sample
        with following(sandbox, "grows", output) as reader:
            half = len(data) // 2
            recording.write(data[1003:half])
            # What the chain holds back: a group for its neighbour, and one that is not whole.
            wait_until(lambda: rows_in(output) >= count // 2 - 3, process=reader)
            assert rows_in(output) < count - 2
            recording.write(data[half:])
            wait_until(lambda: rows_in(output) >= count - 2, process=reader)
            reader.send_signal(signal.SIGINT)
            _, said = reader.communicate(timeout=300)
    assert reader.returncode == 0, said
    assert output.read_text() == readings
    assert counted(said)[0] == count - 1


def test_a_gap_that_a_recorder_notes_while_we_read_is_a_gap_in_the_readings(sandbox):
    data = (sandbox.folder / "press.sigmf-data").read_bytes()
    meta = json.loads((sandbox.folder / "press.sigmf-meta").read_text())
    lost = 3 * GROUP
    meta["global"].pop("core:sha512", None)
    meta["captures"] = [{"core:sample_start": 0}]
    path = sandbox.folder / "gappy.sigmf-meta"
    path.write_text(json.dumps(meta))
    output = sandbox.folder / "gappy.jsonl"
    with open(sandbox.folder / "gappy.sigmf-data", "wb", buffering=0) as recording:
        recording.write(data[: 4 * 20 * GROUP])
        with following(sandbox, "gappy", output) as reader:
            wait_until(lambda: rows_in(output) >= 19, process=reader)
            meta["captures"].append(
                {"core:sample_start": 20 * GROUP, "core:global_index": 20 * GROUP + lost}
            )
            (sandbox.folder / "new").write_text(json.dumps(meta))
            os.replace(sandbox.folder / "new", path)
            recording.write(data[4 * (20 * GROUP + lost) :])
            wait_until(lambda: rows_in(output) >= 28, process=reader)
            reader.send_signal(signal.SIGTERM)
            _, said = reader.communicate(timeout=300)
    assert reader.returncode == 0, said
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    assert [i for i, row in enumerate(rows) if row["flags"] == "gap"] == [20, 21, 22]
    groups, clear, flagged, dropped = counted(said)
    assert groups == len(rows) == clear + flagged + dropped and dropped == 3


@pytest.mark.parametrize("cores", [1, pytest.param(2, marks=pytest.mark.long)])
def test_the_same_capture_gives_the_same_bytes_on_any_number_of_cores(sandbox, readings, cores):
    chosen = sorted(os.sched_getaffinity(0))[:cores]
    done = sandbox.run("read", "press", *READ, before=lambda: os.sched_setaffinity(0, chosen))
    assert done.returncode == 0, done.stderr
    assert done.stdout == readings
    # The summary counts every group once.
    rows = list(csv.DictReader(readings.splitlines()))
    samples = (sandbox.folder / "press.sigmf-data").stat().st_size // 4
    groups, clear, flagged, dropped = counted(done.stderr)
    assert groups == len(rows) == samples // GROUP
    assert clear == sum(not row["flags"] for row in rows)
    assert flagged == groups - clear and dropped == 0


@pytest.mark.timeout(3000)
def test_a_killed_reader_leaves_whole_rows_and_no_hindrance(sandbox, readings, long_run):
    """Killed at random moments of a run that goes on for as long as it is let."""
    rng = np.random.default_rng(11)
    for suffix in (".sigmf-data", ".sigmf-meta"):
        shutil.copy(sandbox.folder / f"press{suffix}", sandbox.folder / f"killed{suffix}")
    output = sandbox.folder / "killed.csv"
    began = time.monotonic()
    sandbox.run("read", "killed", *READ, "-o", output, before=os.getpid)  # in a process
    complete_s = time.monotonic() - began
    for _ in range(LONG_KILLS if long_run else KILLS):
        output.unlink(missing_ok=True)
        with following(sandbox, "killed", output):
            time.sleep(rng.random() * 1.2 * complete_s)
            seen = output.read_text() if output.exists() else ""
        written = output.read_text() if output.exists() else ""
        assert written == readings[: len(written)] and written[-1:] in ("", "\n")
        assert len(written) >= len(seen)
    done = sandbox.run("read", "killed", *READ, "-o", output)
    assert done.returncode == 0 and output.read_text() == readings
