# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken inputs of every kind: refused in one line or read, never a traceback, hang or flood."""

import os
import subprocess
import sys

import fuzzing
import numpy as np
import pytest

CASES, LONG_CASES = 4, 10_000
# What is not refused starts a process for the radio.
LONG_RADIO_CASES = 500
# These take longer than all else.
FEWER = dict.fromkeys(("metadata", "samples", "snapshots", "symbol", "radio", *fuzzing.TOOLS), 1)
# Readers leave their buffers behind: see "What GNU Radio 3.10 requires" in docs/architecture.md.
CASES_PER_PROCESS = {"metadata": 200, "samples": 200}
PROCESSES = 100


@pytest.fixture(scope="module", autouse=True)
def prepared(tmp_path_factory):
    """The working folder, with every original."""
    folder = tmp_path_factory.mktemp("fuzz")
    fuzzing.prepare(folder)
    before = os.getcwd()
    os.chdir(folder)
    yield
    os.chdir(before)


def fuzz(finds, seed, *options, **counts):
    """Breaks so many inputs of each kind."""
    words = [f"{name}={count}" for name, count in counts.items()] + [*options]
    command = [sys.executable, fuzzing.__file__, str(seed), finds, *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr[-2000:]


def test_a_broken_input_of_any_kind_is_refused_in_one_line_or_read(tmp_path):
    fuzz(tmp_path, 0, **{name: FEWER.get(name, CASES) for name in fuzzing.KINDS})


@pytest.mark.long
@pytest.mark.timeout(20_000)
@pytest.mark.parametrize("name", fuzzing.KINDS)
def test_a_broken_input_is_refused_in_one_line_or_read(tmp_path, name):
    cases = LONG_RADIO_CASES if name == "radio" else LONG_CASES
    at_once = CASES_PER_PROCESS.get(name, cases)
    for seed in range(cases // at_once):
        fuzz(tmp_path, seed, "--explore", **{name: at_once})


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("name", fuzzing.KINDS)
def test_a_process_ends_as_its_entry_function_does(name):
    kind = fuzzing.kind_of(name)
    for seed in range(PROCESSES):
        arguments = kind.put(kind.broken(np.random.default_rng(seed)))
        done = subprocess.run(
            ["gr-wiforce", *arguments], capture_output=True, text=True, timeout=100
        )
        assert fuzzing.fault_of(done.returncode, done.stderr) is None, f"{name} {seed}"
