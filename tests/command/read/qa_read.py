# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce read` and `demo` as a user runs them, and their messages for bad input."""

import csv
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import yaml
from command_runs import ended_by, refused, run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from long_cases import cases
from machine import full_disk, rows_in


@pytest.fixture(scope="module")
def read_args(demo):
    folder, _ = demo
    return ["read", folder / "demo", "--scene", folder / "scene.yaml"]


@pytest.fixture(scope="module")
def printed(read_args):
    """The demo's capture, read to standard output."""
    return run_command(*read_args)


def test_demo_reaches_its_limits_and_draws_a_picture(demo):
    folder, done = demo
    assert done.returncode == 0, done.stdout + done.stderr
    assert "median error over" in done.stdout
    assert (folder / "readings.png").read_bytes().startswith(b"\x89PNG")
    rows = [list(map(float, re.findall(r"\d+\.\d+", line))) for line in demo[1].stdout.splitlines()]
    rows = [row for row in rows if len(row) == 7]  # time, then value, deviation and truth of both
    assert len(rows) > 5 and all(abs(force - true) < 0.5 for _, force, _, true, *_ in rows)


def test_read_prints_what_a_flowgraph_reads(demo, printed):
    assert printed.stdout == (demo[0] / "readings.csv").read_text()
    assert printed.stdout.count("\n") == 1 + 83
    assert printed.stderr.startswith("gr-wiforce: read 83 groups: ")
    assert printed.stderr.count("\n") == 1


def test_read_writes_all_rows_beside_an_output_that_becomes_full(printed, read_args, tmp_path):
    full, whole = tmp_path / "full.jsonl", tmp_path / "whole.csv"
    with full_disk(len(printed.stdout)):
        done = run_command(*read_args, "-o", full, "-o", whole)
    assert done.returncode == 1 and f"{full}: cannot be written further" in done.stderr
    assert whole.read_text() == printed.stdout
    assert 0 < rows_in(full) < rows_in(whole) - 1


def test_read_loads_neither_scipy_nor_pandas(read_args):
    """Reading a short capture would take half as long again."""
    code = (
        "import sys; from wiforce_app.main import run; status = run(); print(*sys.modules); "
        "sys.exit(status)"
    )
    command = [sys.executable, "-c", code, *map(str, read_args)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert "wiforce_app" in loaded and not {"scipy", "pandas", "matplotlib"} & loaded


def cut(demo, tmp_path, size):
    """The demo's capture, truncated to ``size`` bytes of data."""
    for suffix in (".sigmf-meta", ".sigmf-data"):
        shutil.copy(demo[0] / f"demo{suffix}", tmp_path / f"cut{suffix}")
    with open(tmp_path / "cut.sigmf-data", "r+b") as data:
        data.truncate(size)
    return tmp_path / "cut"


def test_read_capture_truncated_in_frame_reads_whole_groups(demo, printed, read_args, tmp_path):
    capture = cut(demo, tmp_path, 4 * (20 * 450_000 + 1234))
    done = succeeded("read", capture, *read_args[2:])
    warning, summary = done.stderr.splitlines()
    lacking = 37_499_760 - (20 * 450_000 + 1234)
    assert f"cut.sigmf-data: ends {lacking} samples before the 37499760 that" in warning
    assert "read 20 groups" in summary
    whole = printed.stdout.splitlines()
    rows = done.stdout.splitlines()
    assert len(rows) == 1 + 20
    # The last group has no next neighbour; all others equal those of the whole capture.
    assert rows[:-1] == whole[:20]


def completed(command, _):
    """Exit status and messages of a command."""
    done = run_command(*command)
    return done.returncode, done.stderr


def followed(command, output):
    """The same of one that waits for more samples, interrupted when it has read 30 groups."""
    return ended_by(signal.SIGINT, lambda: rows_in(output) > 30, *command, "--follow")


@pytest.mark.parametrize("follow", cases(True, long=(False,)))
def test_read_unreported_sample_loss_warns_of_shifted_timing(demo, read_args, tmp_path, follow):
    capture = cut(demo, tmp_path, 0)
    with open(demo[0] / "demo.sigmf-data", "rb") as stream:
        whole, lost = stream.read(4 * 450_000 * 40), 4 * (20 * 450_000 + 1234)
    capture.with_suffix(".sigmf-data").write_bytes(whole[:lost] + whole[lost + 4 * 777 :])
    command = ["read", capture, *read_args[2:], "-o", tmp_path / "out.csv"]
    status, said = (followed if follow else completed)(command, tmp_path / "out.csv")
    lines = said.splitlines()
    assert status == 0
    warnings = [line for line in lines if "frame timing shifted once; times may be off" in line]
    assert len(warnings) == 1 and str(capture) in warnings[0]
    # No samples are known to be missing. The summary may count the group before the slip as lost.
    assert not any("lost" in line for line in lines[:-1])


@pytest.mark.parametrize(
    "size, message", [(0, "is empty"), (4 * 450_000 * 3, "must hold 14 phase groups")]
)
def test_read_capture_too_short_is_refused(demo, read_args, tmp_path, size, message):
    said = refused("read", cut(demo, tmp_path, size), *read_args[2:], "-o", tmp_path / "out.csv")
    assert message in said and not (tmp_path / "out.csv").exists()


def test_read_second_antenna_missing_keeps_earlier_output(demo, tmp_path):
    folder, _ = demo
    scene = yaml.safe_load((folder / "scene.yaml").read_text())
    scene["environment"] |= {"reader_clock": "free", "receive_antennas": 2}
    scene["sensors"][0]["model"] = str(folder / "sensor.yaml")
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    output = tmp_path / "out.csv"
    output.write_text("precious")
    said = refused("read", folder / "demo", "--scene", tmp_path / "scene.yaml", "-o", output)
    assert "demo.antenna2.sigmf-meta: no such file" in said
    assert output.read_text() == "precious"


@pytest.mark.parametrize(
    "options, message",
    [
        (["-o", "out.txt"], "must end in .csv, .jsonl or .parquet"),
        (["-o", "-"], "-: output must end in .csv, .jsonl or .parquet (standard output: leave -o"),
        (["-o", "none/out.csv"], "none/out.csv: cannot be written"),
        (["--plot", "out.gif"], "name of a picture must end in"),
        (["--datatype", "ci8"], "'ci8' is not one of"),
        (["--frame-offset", "-1"], "--frame-offset"),
    ],
)
def test_read_invalid_option_is_refused_before_reading(read_args, tmp_path, options, message):
    said = refused(*read_args, *options, cwd=tmp_path)
    assert message in said and list(tmp_path.iterdir()) == []


def test_read_function_bad_frame_offset_is_refused(demo):
    folder, _ = demo
    for offset in (-1, 1.5, "0"):
        with pytest.raises(InputError, match="frame_offset: must be an integer of at least 0"):
            wiforce.read(folder / "demo", folder / "scene.yaml", frame_offset=offset)


def test_read_function_capture_without_finite_samples_is_refused(tmp_path):
    """An empty table without a word would look like a capture in which nothing was pressed."""
    np.full(16 * 125 * 320, np.nan, np.complex64).tofile(tmp_path / "nan.cf32")
    with pytest.raises(InputError, match="nan.cf32: holds no whole frame of finite samples"):
        wiforce.read(tmp_path / "nan.cf32", "tabletop", datatype="cf32_le")


def test_read_capture_starting_in_frame_is_aligned(demo, read_args, tmp_path):
    whole = (demo[0] / "demo.sigmf-data").read_bytes()
    (tmp_path / "late.bin").write_bytes(whole[4 * 500 : 4 * 450_000 * 30])
    done = succeeded("read", tmp_path / "late.bin", *read_args[2:], "--datatype", "ci16_le")
    # Each untouched recording of `live` was said to end inside a frame.
    place, summary = done.stderr.splitlines()
    assert "the first frame begins at sample 214" in place and "read 29 groups" in summary
    rows = list(csv.DictReader(done.stdout.splitlines()))
    touched = [row for row in rows if row["touch"] == "1" and not row["flags"]]
    assert touched and all(abs(float(row["location_mm"]) - 45) < 0.3 for row in touched)


@pytest.mark.parametrize(
    "start, rest, said",
    [
        # A press in the reference, which is released later.
        (27, 0, "begin untouched, or release it and tare"),
        (13, 0, "rest on the untouched ones before or behind; begin untouched"),
        (0, 1, "ends within a sample, of which 1 byte is left out; is it whole?"),
    ],
)
def test_read_names_what_is_wrong_with_the_samples(demo, tmp_path, start, rest, said):
    """Only the counts of flags said that something was wrong."""
    whole = (demo[0] / "demo.sigmf-data").read_bytes()
    samples = whole[4 * 450_000 * start : 4 * 450_000 * (start + 18)]
    (tmp_path / "odd.bin").write_bytes(samples + bytes(rest))
    done = succeeded("read", tmp_path / "odd.bin", "--scene", "demo", "--datatype", "ci16_le")
    (warning,) = [line for line in done.stderr.splitlines() if "warning" in line]
    assert "odd.bin: " in warning and warning.endswith(said)


def test_read_overlapping_pulses_are_flagged_and_not_read(tmp_path):
    press = {"start_s": 0.6, "rise_s": 0.03, "hold_s": 0.3, "force_n": 4.0, "location_mm": 40.0}
    tag = {"sensor": "arm", "clock2_duty": "overlapping"}
    simulation = {"duration_s": 0.9, "snr_db": 15, "static_clutter_db": 50, "presses": [press]}
    scene = {"sensors": [{"name": "arm", "model": "line-900mhz"}], "reference_s": 0.3}
    wiforce.simulate({**scene, "simulation": simulation | {"tags": [tag]}}, tmp_path / "air")
    rows = wiforce.read(tmp_path / "air")
    assert set(rows["flags"]) == {"inconsistent", "reference inconsistent"}
    assert len(rows) == 25 and rows[["touch", "force_n", "phase1_deg"]].isna().all(axis=None)
