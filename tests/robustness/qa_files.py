# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks that fill up, and names nobody expects."""

import os
import shutil

import numpy as np
import pytest
from long_cases import cases
from machine import room_for

READ = ("--scene", "scene.yaml")


def complaint(done, status):
    """The one line that a failed command said."""
    assert done.returncode == status, done
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("gr-wiforce: "), done.stderr
    return done.stderr


@pytest.mark.parametrize("seed", cases(0, long=(1, 2, 3)))
def test_a_full_disk_keeps_every_whole_row_and_is_reported_in_one_line(sandbox, readings, seed):
    size = int(np.random.default_rng(seed).integers(len(readings)))
    output = sandbox.folder / f"full{seed}.csv"
    done = sandbox.run("read", "press", *READ, "-o", output, before=room_for(size))
    assert f"{output}: cannot be written further" in complaint(done, 1)
    assert done.stdout == ""
    kept = output.read_text()
    assert kept == readings[: len(kept)] and kept[-1:] in ("", "\n")
    rest = readings[len(kept) :]
    assert len(kept) + len(rest.splitlines(keepends=True)[0]) > size


def test_without_a_home_and_with_every_standard_stream_closed_the_file_is_the_same(
    sandbox, readings
):
    def bare():
        os.environ["HOME"] = "/nowhere"
        os.closerange(0, 3)

    output = sandbox.folder / "bare.csv"
    assert sandbox.run("read", "press", *READ, "-o", output, before=bare).returncode == 0
    assert output.read_text() == readings


def test_a_full_disk_leaves_nothing_of_a_simulation(sandbox):
    done = sandbox.run("simulate", "scene.yaml", "none", before=room_for(100_000))
    assert "none: cannot be written (File too large)" in complaint(done, 1)
    assert not [name for name in os.listdir(sandbox.folder) if "none" in name or name[0] == "."]


@pytest.mark.parametrize(
    "name", ["/", "", ".", "x" * 5000, "/dev/zero", "a\nb", "press/x", "\x1b[2J"]
)
@pytest.mark.parametrize("kind", [(), ("--datatype", "ci16_le")])
def test_what_is_no_capture_is_refused(sandbox, name, kind):
    complaint(sandbox.run("read", name, *READ, *kind), 2)


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "scene.yaml", "/"),
        ("simulate", "scene.yaml", ""),
        ("simulate", "scene.yaml", "/proc/x"),
        ("read", "press", "--scene", "/dev/zero"),
        ("read", "press", "--scene", "x" * 5000 + ".yaml"),
        ("read", "press", *READ, "-o", "/proc/x.csv"),
        ("read", "press", *READ, "-o", "o.csv", "--plot", "scene.yaml/x.png"),
        ("invert", "/dev/zero", "--sensor", "wiforce-900mhz"),
        ("invert", "scene.yaml", "--sensor", "x" * 5000),
        ("calibrate", "/dev/zero", "-o", "x.yaml"),
        ("calibrate", ".", "-o", "x.yaml"),
    ],
)
def test_names_that_cannot_be_used_are_refused_before_any_work(sandbox, arguments):
    before = sorted(os.listdir(sandbox.folder))
    complaint(sandbox.run(*arguments), 2)
    assert sorted(os.listdir(sandbox.folder)) == before


@pytest.mark.parametrize(
    "name",
    [
        "Prüfung 1.5 N",
        "-x",
        "a'b\"c;$(d)",
        "été\u2028neu",
        "~",
        "%s",
        "a\nb",
        os.fsdecode(b"caf\xe9"),
    ],
)
def test_any_name_that_the_system_takes_is_read(sandbox, readings, name):
    for suffix in (".sigmf-data", ".sigmf-meta"):
        shutil.copy(sandbox.folder / f"press{suffix}", sandbox.folder / f"{name}{suffix}")
    done = sandbox.run("read", *READ, "-o", f"{name}.csv", "--", name)
    assert done.returncode == 0 and done.stderr.count("\n") == 1, done.stderr
    assert (sandbox.folder / f"{name}.csv").read_text() == readings
