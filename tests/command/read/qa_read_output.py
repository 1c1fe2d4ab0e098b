# SPDX-License-Identifier: GPL-3.0-or-later
"""What `gr-wiforce read` writes: rows that join with the truth, and partial output that says so."""

import json
import re
import shutil
import signal
import subprocess
from contextlib import closing

import numpy as np
import pandas
import pytest
import yaml
from command_runs import ended_by, refused, rows_of, run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.sensor import load_sensor, write_sensor
from long_cases import cases
from machine import rows_in, wait_until
from pyarrow import parquet
from ros_clients import bag_messages

# A tenth of the usual sample rate, and groups so short that their centres need seven decimals.
SCENE = {
    "radio": {"sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 321},
    "phase_group": {"snapshots": 63},
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 400}],
    "reference_s": 0.2,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 1.5,
        "snr_db": 20,
        "presses": [
            {"sensor": "arm", "start_s": 0.8, "hold_s": 0.4, "force_n": 4.0, "location_mm": 45.0}
        ],
    },
}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A short capture with its scene beside it; path without suffix."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    wiforce.simulate(wiforce.load_scene(folder / "scene.yaml"), folder / "press")
    return folder / "press"


def test_read_rows_join_with_the_truth_by_time_and_by_group(capture, tmp_path):
    """Otherwise a user compares readings with the wrong row of the truth, or with none."""
    succeeded("read", capture, "-o", tmp_path / "out.csv")
    read, truth = rows_of(tmp_path / "out.csv"), rows_of(f"{capture}.truth.csv")
    assert [row["time_s"] for row in read] == [row["time_s"] for row in truth]
    assert any(len(row["time_s"].partition(".")[2]) > 6 for row in truth)
    assert [int(row["group"]) for row in read] == list(range(len(truth)))
    groups = wiforce.read(capture)["group"]
    assert groups.dtype == np.int64 and groups.tolist() == list(range(len(truth)))


def test_read_writes_the_same_rows_to_each_output_that_is_given(capture, tmp_path):
    """All but the last were not written, without a word; a file passed on describes itself."""
    files = [tmp_path / f"out.{form}" for form in ("csv", "jsonl", "parquet", "mcap", "png")]
    options = ("-o", "-o", "-o", "--mcap", "--plot")
    given = [word for pair in zip(options, files, strict=True) for word in pair]
    said = succeeded("read", capture, *given).stderr
    assert f"wrote {', '.join(map(str, files))}" in said
    table = files[2]
    rows, frame = rows_of(files[0]), pandas.read_parquet(table)
    lines = [json.loads(line) for line in files[1].read_text().splitlines()]
    assert [{k: "" if v is None else str(v) for k, v in line.items()} for line in lines] == rows
    messages = bag_messages(files[3])["/wiforce/arm/reading"]
    for name in ("time_s", "force_n", "location_std_mm", "snr_db", "group"):
        column = [float(row[name] or "nan") for row in rows]
        assert np.array_equal(frame[name], column, equal_nan=True)
        if name != "group":
            assert np.array_equal([getattr(m, name) for m in messages], column, equal_nan=True)
    assert frame["flags"].tolist() == [row["flags"] for row in rows]
    truth = pandas.read_csv(f"{capture}.truth.csv")
    assert len(frame.merge(truth, on=["time_s", "sensor"])) == len(rows)
    described = parquet.read_schema(table).metadata
    assert json.loads(described[b"wiforce:scene"])["sensors"][0]["name"] == "arm"
    assert json.loads(described[b"wiforce:sensors"])["arm"]["length_mm"] == 80
    assert described[b"wiforce:version"]
    assert files[4].stat().st_size > 10_000


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["read", "press", "-o", "a.csv", "-o", "./a.csv"], "./a.csv: must be given once"),
        (["invert", "p.csv", "--sensor", "s", "-o", "a.csv", "-o", "a.csv"], "must be given once"),
        (["live", "--scene", "demo", "-o", "a.csv", "-o", "a.csv"], "must be given once"),
        (["read", "press", "none", "-o", "a", "-o", "b"], "--output: must be given once for"),
    ],
)
def test_outputs_that_cannot_be_written_beside_each_other_are_refused(
    capture, tmp_path, arguments, message
):
    """The file of two writers would hold each row twice, or parts of rows."""
    (tmp_path / "press").symlink_to(capture)
    assert message in refused(*arguments, cwd=tmp_path)
    assert not list(tmp_path.glob("a*"))


def test_output_that_is_the_scene_or_a_raw_capture_is_refused(capture, tmp_path):
    scene = tmp_path / "press.truth.csv"
    scene.write_text(yaml.safe_dump(SCENE))
    assert "is an input" in refused("simulate", scene, tmp_path / "press", "--force")
    assert [path.name for path in tmp_path.iterdir()] == [scene.name]
    said = refused("read", capture, "--scene", scene, "-o", scene)
    assert f"{scene}: cannot be written (is an input)" in said
    raw = tmp_path / "raw.csv"
    raw.symlink_to(f"{capture}.sigmf-data")
    options = ["--datatype", "ci16_le", "--scene", scene, "-o", raw]
    assert run_command("read", raw, *options).returncode == 2
    assert wiforce.load_scene(scene).sensor_names == ("arm",)


@pytest.mark.parametrize(
    "arguments, target, ending",
    [
        (["read", "press", "-o"], "press.sigmf-data", ".csv"),
        (["read", "press", "--plot"], "press.sigmf-meta", ".png"),
        (["read", "press", "-o"], "press.truth.csv", ".csv"),
        (["invert", "phases.csv", "--sensor", "own.yaml", "-o"], "phases.csv", ".csv"),
        (["invert", "phases.csv", "--sensor", "own.yaml", "-o"], "own.yaml", ".csv"),
        (["calibrate", "vna.csv", "-o"], "vna.csv", ".yaml"),
        (["calibrate", "vna.csv", "-o", "new.yaml", "--plot"], "vna.csv", ".png"),
        (["transfer", "own.yaml", "--frequency-hz", "905e6", "-o"], "own.yaml", ".yaml"),
        (["survey", "press", "--plot"], "press.sigmf-data", ".png"),
    ],
)
def test_command_output_that_is_an_input_is_refused(capture, tmp_path, arguments, target, ending):
    """A 150 MB capture became 1 kB of CSV."""
    (tmp_path / "phases.csv").write_text("phase1_deg,phase2_deg\n-100,-110\n")
    (tmp_path / "vna.csv").write_text("freq_mhz,location_mm,port,force_n,phase_deg\n900,,1,0,5\n")
    write_sensor(load_sensor("line-900mhz"), tmp_path / "own.yaml")
    for suffix in (".sigmf-data", ".sigmf-meta", ".truth.csv"):
        shutil.copy(f"{capture}{suffix}", tmp_path / f"press{suffix}")
    before = (tmp_path / target).read_bytes()
    (tmp_path / f"link{ending}").hardlink_to(tmp_path / target)
    said = refused(*arguments, f"link{ending}", cwd=tmp_path)
    assert "is the same file as the input" in said
    assert (tmp_path / target).read_bytes() == before


@pytest.mark.parametrize(
    "number, status", cases((signal.SIGINT, 130), long=((signal.SIGTERM, 143),))
)
def test_read_interrupted_says_that_its_output_is_partial(tmp_path, number, status):
    """A script that is stopped at night must not take half a file for a whole one."""
    scene = {**SCENE, "simulation": {**SCENE["simulation"], "duration_s": 3.0, "presses": []}}
    wiforce.simulate(wiforce.load_scene(scene), tmp_path / "long")
    # So many groups that reading takes several seconds: the data are repeated, with one frame grid.
    data = (tmp_path / "long.sigmf-data").read_bytes()
    frames = len(data) // (4 * 321)
    with open(tmp_path / "long.sigmf-data", "wb") as stream:
        for _ in range(20):
            stream.write(data[: 4 * 321 * frames])
    forget_checksum(tmp_path / "long.sigmf-meta")
    output = tmp_path / "out.csv"
    bag = tmp_path / "out.mcap"
    command = "read", tmp_path / "long", "-o", output, "--mcap", bag
    ended, said = ended_by(number, lambda: rows_in(output) > 20, *command)
    assert ended == status
    partial = r"out.csv is partial: it holds the first (\d+) of (\d+) rows"
    found = re.search(partial, said.splitlines()[-1])
    assert found, said
    assert len(rows_of(output)) == int(found[1]) < int(found[2])
    assert len(bag_messages(bag)["/wiforce/arm/reading"]) == int(found[1])


def forget_checksum(meta):
    """Remove the checksum of samples that are changed on purpose."""
    content = json.loads(meta.read_text())
    content["global"].pop("core:sha512", None)
    meta.write_text(json.dumps(content))
    return content


class Growing:
    """A capture of which a part is in the file, with ``read --follow`` on it."""

    def __init__(self, capture, folder, share, silence=0):
        self.meta = folder / "grow.sigmf-meta"
        shutil.copy(f"{capture}.sigmf-meta", self.meta)
        self.content = forget_checksum(self.meta)
        samples = np.fromfile(f"{capture}.sigmf-data", "<i4")
        self.data = np.concatenate([np.zeros(silence, "<i4"), samples])
        self.written = silence + int(share * len(samples))
        self.data[: self.written].tofile(folder / "grow.sigmf-data")
        self.path, self.output = folder / "grow.sigmf-data", folder / "out.csv"
        command = ["gr-wiforce", "read", str(self.path), "--follow", "-o", str(self.output)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def wait_for_rows(self, count):
        wait_until(lambda: rows_in(self.output) >= count, process=self.process)

    def grow(self):
        """Metadata first, then the rest of the samples, as a recorder does."""
        self.meta.write_text(json.dumps(self.content))
        with open(self.path, "ab") as stream:
            stream.write(self.data[self.written :].tobytes())

    def close(self):
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def growing(capture, tmp_path):
    with closing(Growing(capture, tmp_path, 0.6)) as grown:
        yield grown


@pytest.mark.parametrize("silence", [0, 700_000])
def test_follow_waits_for_a_transmitter_that_is_switched_on_later(capture, tmp_path, silence):
    """A recorder that was started first had to be started again."""
    with closing(Growing(capture, tmp_path, 0.0, silence)) as grown:
        if silence:
            said = grown.process.stderr.readline()
            assert "grow.sigmf-data: waiting, as it holds no frames yet (waveform" in said
        else:
            with pytest.raises(subprocess.TimeoutExpired):
                grown.process.wait(2)
        grown.grow()
        grown.wait_for_rows(3)


@pytest.mark.parametrize(
    "change, message",
    cases(
        ("gap", "metadata report a gap at sample 400000 only after that sample was read"),
        ("rate", "sample rate must not change while the capture is read"),
        long=(("carrier", "carrier must not change while the capture is read"),),
    ),
)
def test_follow_metadata_that_contradict_what_was_read_end_the_run(growing, change, message):
    """It hung until SIGKILL, or went on with wrong times or phases."""
    growing.wait_for_rows(40)
    first = growing.content["captures"][0]
    if change == "gap":
        late = {**first, "core:sample_start": 400_000, "core:global_index": 500_000}
        growing.content["captures"].append(late)
    elif change == "rate":
        growing.content["global"]["core:sample_rate"] = 2e6
    else:
        first["core:frequency"] = 905e6
    growing.grow()
    said = growing.process.communicate(timeout=300)[1]
    assert growing.process.returncode == 2 and message in said
    assert len(rows_of(growing.output)) >= 39
