# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends of live runs: killed, out of disk space, without its device, started again."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import session_runs
import zmq
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.scene import load_scene
from live_runs import (
    FRAMES,
    GAINS,
    SLOW_GROUP_S,
    ask,
    connected,
    free_ports,
    live,
    rows_of,
    streaming_s,
    wait_until,
)
from machine import room_for

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


def test_live_device_gone_reports_and_keeps_readings(software_usrp, slow_scene, tmp_path):
    device = software_usrp(slow_scene)
    output = tmp_path / "out.csv"
    with live(device.args, slow_scene, *GAINS, "-o", output) as process:
        wait_until(lambda: streaming_s(device) > 1.0)
        device.process.kill()
        _, said = process.communicate(timeout=300)
    assert process.returncode == 1
    lost = said.splitlines()[-1]
    # On a busy machine UHD may notice before the silence is long enough.
    assert "has sent no samples" in lost or "cannot be reached any more" in lost
    assert device.address in lost
    assert len(rows_of(output)) > 15


@pytest.mark.long
def test_live_device_stalled_or_late_loses_nothing(software_usrp, slow_scene, tmp_path):
    """A second without a sample costs nothing, and a start that was missed is tried again; what
    came is recorded."""
    device = software_usrp(slow_scene, faults=["+0.8 stall 1.0"])
    script = Path(session_runs.__file__)
    command = [
        sys.executable,
        str(script),
        "on_request",
        str(slow_scene),
        f"{device.args},{FRAMES}",
    ]
    command.append(str(tmp_path / "run"))
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "opened\n"
        for direction in ("rx", "tx"):
            device.command(f"fault 0 late {direction}")
        output, _ = process.communicate("start\n", timeout=300)
    assert process.returncode == 0
    found = json.loads(output.splitlines()[-1])
    status = device.command("status")
    assert status["faults"] == 3 and status["tx_late_packets"] > 0
    assert found["gaps"] == 0
    assert np.allclose(np.diff(found["time_s"]), SLOW_GROUP_S)
    assert found["time_s"][-1] > 1.2
    recorded = open_capture(tmp_path / "run")
    assert recorded.span == recorded.samples
    assert recorded.samples / 2.5e6 > found["time_s"][-1]
