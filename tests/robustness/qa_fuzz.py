# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken inputs of every kind: refused in one line or read, never a traceback, hang or flood.

Inputs that once broke a command are kept in ``corpus/``, named by their kind.
"""

import os
import subprocess
import sys
from pathlib import Path

import fuzzing
import pytest

# As many as some seconds allow.
CASES = {"scene": 100, "sensor": 25, "vna": 25, "phases": 25}
CASES |= {"index": 25, "touchstone": 10, "metadata": 15, "samples": 5}
LONG_CASES, PROCESSES = 10_000, 100
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
KINDS = tuple(CASES)


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    before = os.getcwd()
    os.chdir(folder)
    yield fuzzing.kinds(folder)
    os.chdir(before)


@pytest.mark.timeout(20_000)
@pytest.mark.parametrize("name", KINDS)
def test_a_broken_input_is_refused_in_one_line_or_read(tmp_path, name, long_run):
    count = str(LONG_CASES if long_run else CASES[name])
    # A process of its own: what it remembers must not come from the tests before.
    done = subprocess.run(
        [sys.executable, fuzzing.__file__, name, count],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr[-2000:]


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_once_broke_a_command_does_not_again(kinds, path):
    kind = kinds[path.name.split("-")[0]]
    try:
        assert fuzzing.check(kind, path.read_bytes(), path.name) is None
    finally:
        Path(kind.file).write_bytes(kind.original)


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("name", KINDS)
def test_a_process_ends_as_its_entry_function_does(kinds, name, long_run):
    kind = kinds[name]
    try:
        for seed in range(PROCESSES if long_run else 1):
            Path(kind.file).write_bytes(kind.broken(seed))
            done = subprocess.run(
                ["gr-wiforce", *kind.arguments], capture_output=True, text=True, timeout=100
            )
            assert fuzzing.fault_of(done.returncode, done.stderr) is None, f"{name} {seed}"
    finally:
        Path(kind.file).write_bytes(kind.original)
