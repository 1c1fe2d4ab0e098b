# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken inputs of every kind: refused in one line or read, never a traceback, hang or flood.

Inputs that once broke a command are kept in ``corpus/``, named by their kind.
"""

import os
import subprocess
from pathlib import Path

import fuzzing
import pytest

CASES, LONG_CASES, PROCESSES = 200, 10_000, 100
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
KINDS = ("scene", "sensor", "vna", "index", "touchstone", "phases", "metadata", "samples")


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    before = os.getcwd()
    os.chdir(folder)
    yield fuzzing.kinds(folder)
    os.chdir(before)


def largest_memory():
    """Peak of this process's memory in bytes since it was last reset."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    raise LookupError("VmHWM")


def check(kind, data, told):
    Path(kind.file).write_bytes(data)
    try:
        status, said, _ = fuzzing.call(kind.arguments)
    except fuzzing.Hang as hang:
        return f"{told}: {hang}"
    fault = fuzzing.fault_of(status, said)
    return f"{told}: {fault}" if fault else None


@pytest.mark.timeout(20_000)
@pytest.mark.parametrize("name", KINDS)
def test_a_broken_input_is_refused_in_one_line_or_read(kinds, name, long_run):
    kind = kinds[name]
    assert check(kind, kind.original, "the original") is None
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    try:
        seeds = range(LONG_CASES if long_run else kind.cases)
        found = [check(kind, kind.broken(seed), f"{name} {seed}") for seed in seeds]
    finally:
        Path(kind.file).write_bytes(kind.original)
    assert not list(filter(None, found)), "\n".join(filter(None, found))
    assert largest_memory() < fuzzing.LIMIT_BYTES


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_once_broke_a_command_does_not_again(kinds, path):
    kind = kinds[path.name.split("-")[0]]
    try:
        assert check(kind, path.read_bytes(), path.name) is None
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
