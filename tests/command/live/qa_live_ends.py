# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends of live runs: killed, out of disk space, started again."""

import json
import re
import signal
import time

import numpy as np
import pytest
import zmq
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.scene import load_scene
from live_runs import (
    GAINS,
    SLOW,
    SLOW_GROUP_S,
    ask,
    connected,
    free_ports,
    live,
    rows_of,
    scene_file,
)
from machine import room_for, wait_until

KILLS = 100


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_live_killed_at_any_moment_keeps_all_but_the_last_second_and_runs_again(
    slow_scene, slow_device, tmp_path
):
    rng = np.random.default_rng(11)
    output, (readings_port, control_port) = tmp_path / "out.jsonl", free_ports(2)
    options = [*GAINS, "-o", output, "--zmq", readings_port, "--control", control_port]

    def run_until(time_s, number, *more):
        """What had been received when the reader was ended, in seconds."""
        with (
            live(slow_device.args, slow_scene, *options, *more) as process,
            connected(zmq.REQ, control_port) as client,
        ):
            received_s = 0.0
            while received_s < time_s:
                received_s = ask(client, "status")["time_s"]
            if time_s < 0:
                time.sleep(-time_s)  # it starts, or not even that
            process.send_signal(number)
            process.communicate(timeout=300)
        assert process.returncode == (0 if number == signal.SIGTERM else -number)
        return received_s

    for kill in range(KILLS):
        recording = tmp_path / f"run{kill}"
        output.unlink(missing_ok=True)
        received_s = run_until(rng.uniform(-2.0, 2.5), signal.SIGKILL, "--record", recording)
        lines = output.read_text().splitlines() if output.exists() else []
        times = [json.loads(line)["time_s"] for line in lines]
        assert np.allclose(times, SLOW_GROUP_S * (np.arange(len(times)) + 0.5))
        if received_s > 1:
            assert times[-1] > received_s - 1 - SLOW_GROUP_S
            capture = open_capture(recording)
            assert capture.samples / capture.sample_rate_hz > received_s - 1
            capture.check_against(load_scene(slow_scene))
    run_until(0.5, signal.SIGTERM)
    assert len(output.read_text().splitlines()) > 0.5 / SLOW_GROUP_S - 2


def test_live_duration_without_frames_ends_with_a_sentence(slow_device, tmp_path):
    """It never ended, and a script that measures for two seconds waited for good."""
    radio = {**SLOW["radio"], "center_frequency_hz": 902e6}  # where nothing is on the air
    output = tmp_path / "out.csv"
    scene = scene_file(tmp_path, [], 400, 0.3, **{**SLOW, "radio": radio})
    recording, options = tmp_path / "run.sigmf-data", ["--record", tmp_path / "run"]
    options += [*GAINS, "-o", output, "--duration", 0.2]
    with live(slow_device.args, scene, *options) as process:
        wait_until(recording.exists, process=process)
        recording.unlink()
        _, said = process.communicate(timeout=300)
    assert process.returncode == 1
    incomplete = "gr-wiforce: --record: the recording is incomplete (No such file or directory)"
    end = r"gr-wiforce: no sounding frames found in \d\.\d s of samples; there are no readings"
    assert said.splitlines()[-2] == incomplete
    assert re.fullmatch(end, said.splitlines()[-1])
    assert rows_of(output) == []


def test_live_full_disk_reports_and_keeps_all_before(slow_scene, slow_device, tmp_path):
    """First the recording meets its end, then the readings."""
    room = int(np.random.default_rng(2).integers(4500, 6500))  # more than the metadata
    output, recording = tmp_path / "out.csv", tmp_path / "run"
    options = [*GAINS, "-o", output, "--record", recording]
    with live(slow_device.args, slow_scene, *options, before=room_for(room)) as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 1
    (warning,) = [line for line in said.splitlines() if "the recording has ended" in line]
    error = said.splitlines()[-1]
    assert "File too large" in warning
    assert error.startswith(f"gr-wiforce: {output}: cannot be written further")
    text = output.read_text()
    assert room - 100 < len(text) <= room and text.endswith("\n")
    assert np.allclose(np.diff([float(row["time_s"]) for row in rows_of(output)]), SLOW_GROUP_S)
    assert open_capture(recording).samples == room // 4
    assert not list(tmp_path.glob("*.part"))
