# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce read` of several captures."""

import io
import json
import os
import shutil
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas
import pytest
import yaml
from command_runs import ended_by, refused, run_command, succeeded
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.capture.names import find_captures, is_one
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from pyarrow import parquet
from wiforce_app.read.read_many import Journal, ReadingJob, read_capture_file
from wiforce_app.shell import workers

SCENE = {
    "radio": {"center_frequency_hz": 900e6, "sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 320},
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 437.5}],
    "reference_s": 0.6,
    "simulation": {"duration_s": 1.0, "seed": 3, "snr_db": 15, "static_clutter_db": 40},
}

NAMES = ["day1/a", "day1/b", "day2/c", "day2/d"]


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """A folder with four captures in two subfolders, and what each reads alone."""
    folder = tmp_path_factory.mktemp("captures")
    simulate(load_scene(SCENE), folder / "original")
    for name in NAMES:
        (folder / name).parent.mkdir(exist_ok=True)
        copy(folder / "original", folder / name)
    for file in folder.glob("original*"):
        file.unlink()
    alone = succeeded("read", folder / "day1" / "a")
    return folder, alone.stdout


class OneProcess(ThreadPoolExecutor):
    """In place of a pool of processes, each of which takes half a second to start."""

    def __init__(self, *_):
        super().__init__(1)


@pytest.fixture
def in_process(monkeypatch):
    """Tasks run in this process, where which process runs them is not what is tested."""
    monkeypatch.setattr(workers, "ProcessPoolExecutor", OneProcess)


def copy(capture, name):
    """A capture under another name."""
    for suffix in (".sigmf-data", ".sigmf-meta"):
        shutil.copy(f"{capture}{suffix}", f"{name}{suffix}")


def journal(folder):
    """Entries of the record, by capture."""
    with Journal(folder) as record:
        return dict(record.entries)


def test_folder_of_captures_gives_file_of_each_equal_to_reading_it_alone(captures, tmp_path):
    folder, alone = captures
    done = succeeded("read", folder, "-o", tmp_path / "out", "--jobs", 2)
    assert done.stdout == "" and "gr-wiforce: 4 of 4 captures read; " in done.stderr
    for name in NAMES:
        assert (tmp_path / "out" / f"{name}.csv").read_text() == alone
    rows = len(alone.splitlines()) - 1
    assert [entry["rows"] for entry in journal(tmp_path / "out").values()] == [rows] * 4


def test_repeated_run_reads_only_what_is_new_or_changed(in_process, captures, tmp_path):
    folder, _ = captures
    shutil.copytree(folder / "day1", tmp_path / "in")
    arguments = ["read", tmp_path / "in", "-o", tmp_path / "out", "--jobs", 1]
    succeeded(*arguments)
    before = journal(tmp_path / "out")
    again = run_command(*arguments)
    assert "0 of 2 captures read, 2 had been read before" in again.stderr
    copy(tmp_path / "in" / "a", tmp_path / "in" / "new")
    os.utime(tmp_path / "in" / "a.sigmf-data", ns=(1, 1))
    (tmp_path / "out" / "b.csv").write_text("edited")
    third = run_command(*arguments)
    assert "3 of 3 captures read; " in third.stderr
    assert journal(tmp_path / "out")["a"]["fingerprint"] != before["a"]["fingerprint"]
    scene = yaml.safe_dump(SCENE | {"reference_s": 0.5})
    (tmp_path / "scene.yaml").write_text(scene)
    other = run_command(*arguments, "--scene", tmp_path / "scene.yaml")
    assert "3 of 3 captures read; " in other.stderr
    assert other.stderr.count("reference_s is 0.6 in the capture's own scene") == 3


def test_captures_that_fail_are_listed_and_the_others_read(in_process, captures, tmp_path):
    folder, alone = captures
    shutil.copytree(folder / "day1", tmp_path / "in")
    (tmp_path / "in" / "a.sigmf-data").write_bytes(b"")
    (tmp_path / "in" / "two\nlines.sigmf-meta").write_text("{}")
    done = run_command("read", tmp_path / "in", tmp_path / "absent", "-o", tmp_path / "out")
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert lines[0].startswith("gr-wiforce: error: a: ") and lines[0].endswith("is empty")
    assert lines[1].startswith("gr-wiforce: error: absent: ") and "no such file" in lines[1]
    assert lines[2].startswith("gr-wiforce: error: two lines: ")
    assert "1 of 4 captures read, 3 failed" in lines[3]
    files = sorted(file.name for file in (tmp_path / "out").iterdir())
    assert files == ["b.csv", "captures.jsonl"]
    assert (tmp_path / "out" / "b.csv").read_text() == alone


def test_captures_of_one_name_and_bad_outputs_are_refused(captures, tmp_path):
    folder, _ = captures
    copy(folder / "day1" / "a", tmp_path / "a")
    copy(folder / "day1" / "a", tmp_path / "captures")
    both = [folder / "day1" / "a", tmp_path / "a"]
    refusals = {
        "has the same name as": [*both, "-o", tmp_path / "out"],
        "--output: is needed for several captures": [folder],
        "--output: must be a folder": [folder, "-o", tmp_path / "out.csv"],
        "--output: must be a folder, or a file that ends in .parquet": [folder, "-o", "x.json"],
        "readings cannot be called captures.jsonl": [
            *(tmp_path / "[c]aptures*", "-o", tmp_path / "out", "--format", "jsonl")
        ],
        "'': is not the name of a capture": [folder, "", "-o", tmp_path / "out"],
        "scene: must be a .yaml file": [folder, "--scene", "nope", "-o", tmp_path / "out"],
        "--plot takes one capture": [folder, "-o", tmp_path, "--plot", "a.png"],
        "--jobs needs several captures": [folder / "day1" / "a", "--jobs", 2],
        "contains no captures: no .sigmf-meta or .npz files": [
            tmp_path / "*.none",
            "-o",
            tmp_path / "out",
        ],
    }
    for message, arguments in refusals.items():
        assert message in refused("read", *arguments)
    assert not (tmp_path / "out").exists()


def test_patterns_and_folders_find_each_capture_once(captures, tmp_path, monkeypatch):
    folder, _ = captures
    monkeypatch.chdir(folder)
    names = [capture.name for capture in find_captures(["day1", "day*/*", "day2/c.sigmf-meta"])]
    assert names == ["a", "b", "c", "d"]
    assert [capture.name for capture in find_captures(["."])] == NAMES
    copy(folder / "day1" / "a", tmp_path / "a")
    copy(folder / "day1" / "a", tmp_path / "a.antenna2")
    copy(folder / "day1" / "a", tmp_path / "b[1]")
    assert [capture.name for capture in find_captures([str(tmp_path)])] == ["a", "b[1]"]
    assert is_one([str(tmp_path / "b[1]")]) and not is_one([str(tmp_path / "b*")])
    assert not is_one(["day1"]) and not is_one(["day1/a", "day1/b"])
    # Captures of a folder that cannot be searched would be missing without a word.
    error = PermissionError(13, "Permission denied", "day1")
    monkeypatch.setattr(os, "walk", lambda place, onerror: onerror(error))
    with pytest.raises(InputError, match=r"day1: cannot be searched \(Permission denied\)"):
        find_captures(["."])


def test_interrupted_run_keeps_what_is_read_and_says_how_to_go_on(captures, tmp_path):
    folder, alone = captures
    (tmp_path / "in").mkdir()
    for number in range(12):
        copy(folder / "day1" / "a", tmp_path / "in" / f"press{number:02}")
    out = tmp_path / "out"

    def done():
        return list(out.glob("[!.]*.csv"))

    words = "read", tmp_path / "in", "-o", out, "--jobs", "1"
    status, errors = ended_by(signal.SIGINT, lambda: len(done()) >= 2, *words)
    assert status == 130 and 2 <= len(done()) < 12
    assert errors.endswith("captures have been read; the same command reads the others\n")
    assert {file.read_text() for file in done()} == {alone}
    assert not list(out.glob(".*")), "a partial file was left"


def test_one_parquet_file_holds_all_captures_with_their_names(in_process, captures, tmp_path):
    folder, alone = captures
    whole = tmp_path / "all.parquet"
    succeeded("read", folder, "-o", whole, "--jobs", 2)
    frame = pandas.read_parquet(whole)
    expected = pandas.read_csv(io.StringIO(alone), keep_default_na=False, na_values=[""])
    names = frame["capture"].astype(str)
    assert list(names.unique()) == NAMES
    for _, rows in frame.groupby(names):
        assert len(rows) == len(expected)
        for column in ("time_s", "touch", "phase1_deg", "snr_db", "group"):
            found, wanted = rows[column].to_numpy(float), expected[column].to_numpy(float)
            assert np.array_equal(found, wanted, equal_nan=True), column
        assert list(rows["flags"]) == list(expected["flags"].fillna(""))
    stored = json.loads(parquet.read_metadata(whole).metadata[b"wiforce:captures"])
    assert yaml.safe_load(stored["day2/c"]["wiforce:scene"])["reference_s"] == 0.6
    again = run_command("read", folder, "-o", whole, "--jobs", 1)
    assert "0 of 4 captures read, 4 had been read before" in again.stderr
    assert pandas.read_parquet(whole).equals(frame)


def test_folder_that_another_run_writes_to_is_refused(captures, tmp_path):
    folder, _ = captures
    with Journal(tmp_path / "out"):
        done = run_command("read", folder, "-o", tmp_path / "out")
    assert done.returncode == 2 and "is being written to by another process" in done.stderr
    with pytest.raises(InputError, match="cannot be used for readings"):
        Journal("/proc/nowhere")


@pytest.mark.long
def test_snakefile_reads_captures_and_scores_those_with_a_load_cell(captures, tmp_path):
    """The example is what a laboratory starts from; it must at least plan the right jobs."""
    folder, _ = captures
    snakefile = Path(__file__).parents[3] / "examples" / "many_captures" / "Snakefile"
    shutil.copytree(folder / "day1", tmp_path / "captures")
    copy(folder / "day1" / "a", tmp_path / "captures" / "a.antenna2")
    (tmp_path / "captures" / "b.loadcell.csv").write_text("time_s,force_n\n0,0\n1,0\n")
    done = subprocess.run(
        ["snakemake", "-s", snakefile, "--dry-run", "--printshellcmds", "--cores", "1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    lines = (done.stdout + done.stderr).splitlines()
    commands = sorted(" ".join(line.split()) for line in lines if "gr-wiforce" in line)
    assert commands == [
        "gr-wiforce read captures/a.sigmf-meta -o readings/a.csv",
        "gr-wiforce read captures/b.sigmf-meta -o readings/b.csv",
        "gr-wiforce score readings/b.csv --against captures/b.loadcell.csv --json > scores/b.json",
    ]


def test_worker_of_a_former_run_does_not_replace_readings(in_process, captures, tmp_path):
    """After a killed run, readings of its scene must not appear in those of the next one."""
    folder, _ = captures
    output = tmp_path / "out" / "a.csv"
    path = str(folder / "day1" / "a")
    settings = {"datatype": None, "frame_offset": None, "tracked": False}
    left = output.parent / ".gr-wiforce-partial-left"
    left.mkdir(parents=True)
    report = read_capture_file(ReadingJob("a", path, str(output), str(left), None, settings))
    assert not output.exists() and Path(report.partial).parent == left
    output.with_name(".note.txt.csv").touch()
    output.with_name(".partial-of-another").mkdir()
    succeeded("read", folder / "day1" / "a", folder / "day1" / "b", "-o", output.parent)
    names = sorted(file.name for file in output.parent.iterdir())
    kept = [".note.txt.csv", ".partial-of-another"]
    assert names == [*kept, "a.csv", "b.csv", "captures.jsonl"]


def test_captures_of_equal_size_and_time_are_not_confused(in_process, captures, tmp_path):
    """Files that were unpacked or synchronised together often agree in both."""
    folder, alone = captures
    other = load_scene(SCENE | {"simulation": SCENE["simulation"] | {"seed": 4}})
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    copy(folder / "day1" / "a", tmp_path / "one" / "a")
    simulate(other, tmp_path / "two" / "a")
    for file in tmp_path.glob("*/a.sigmf-*"):
        os.utime(file, ns=(1, 1))
    read = [
        run_command("read", tmp_path / name, "-o", tmp_path / "out").stderr
        for name in ("one", "two")
    ]
    assert all("1 of 1 captures read; " in text for text in read), read
    assert (tmp_path / "out" / "a.csv").read_text() != alone


def test_outputs_that_are_captures_are_refused(captures, tmp_path):
    """Raw samples may be called like readings; writing those would destroy the recording."""
    folder, _ = captures
    samples = (folder / "day1" / "a.sigmf-data").read_bytes()
    for name in ("p", "p.csv", "q.parquet"):
        (tmp_path / name).write_bytes(samples)
    raw = ["--datatype", "ci16_le", "--scene", "tabletop"]
    for name, output in (("p.csv", tmp_path), ("q.parquet", tmp_path / "q.parquet")):
        said = refused("read", tmp_path / "p", tmp_path / name, *raw, "-o", output)
        assert "is one of the captures" in said
        assert (tmp_path / name).read_bytes() == samples


def test_whole_file_is_kept_when_no_capture_can_be_read(in_process, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.sigmf-meta").write_text("{}")
    (tmp_path / "all.parquet").write_text("former")
    done = run_command("read", tmp_path / "in", "-o", tmp_path / "all.parquet")
    assert done.returncode == 2 and "was not written" in done.stderr, done.stderr
    assert (tmp_path / "all.parquet").read_text() == "former"


def test_pattern_in_folders_with_links_to_each_other_finds_each_capture(tmp_path, monkeypatch):
    """Two links to a folder above them were followed along all ways, which takes forever."""
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b", "day/c", ".hidden/d"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(f"{name}.sigmf-meta").write_text("{}")
    for name in ("one", "two", "day/three"):
        Path(name).symlink_to(tmp_path)
    Path("self").symlink_to("self")
    for pattern in ("**", "./**/*", f"{tmp_path}/**/*.sigmf-meta"):
        assert [each.name for each in find_captures([pattern])] == ["a", "b", "c"]
    assert [each.name for each in find_captures(["self", "a"])] == ["self", "a"]


def test_journal_on_a_full_disk_is_named(tmp_path):
    """What was still in its buffer failed again as it was closed, without the file's name."""
    full = os.open("/dev/full", os.O_WRONLY)
    with pytest.raises(OutputError, match="captures.jsonl: cannot be written .No space left"):
        with Journal(tmp_path) as journal:
            os.dup2(full, journal._file.fileno())
            journal.note("press", rows=3)
    os.close(full)


def test_journal_with_damaged_lines_keeps_all_others(tmp_path):
    """A disk that was full or a power failure leaves such lines, and editors others."""
    damaged = (b"\xff\xfe", b"[" * 100_000, b'{"capture": []}', b"[1]", b"5", b'{"capture": "c')
    lines = [b'{"capture": "a", "mark": 1}', *damaged]
    (tmp_path / "captures.jsonl").write_bytes(b"\n".join(lines))
    with Journal(tmp_path) as record:
        assert list(record.entries) == ["a"]
        record.note("b", mark="2")
    assert list(journal(tmp_path)) == ["a", "b"]
