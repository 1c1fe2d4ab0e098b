# SPDX-License-Identifier: GPL-3.0-or-later
"""Live runs that go on when the device, the network or the driver fails."""

import fcntl
import json
import os
import signal
import socket
import time
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import zmq
from gnuradio.wiforce.io.capture import open_capture
from live_runs import (
    GAINS,
    SLOW,
    SLOW_GROUP_S,
    ask,
    connected,
    free_ports,
    live,
    rows_of,
    streaming_s,
    wait_until,
)

LOSSES = 50
RATE = SLOW["radio"]["sample_rate_hz"]


def children(process):
    """Processes that a process has started."""
    return [
        int(text)
        for text in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    ]


def held(process):
    """Descriptors, threads and children of a process, and its memory in bytes."""
    folder = Path(f"/proc/{process.pid}")
    pages = int((folder / "statm").read_text().split()[1])
    counts = len(list((folder / "fd").iterdir())), len(list((folder / "task").iterdir()))
    return (*counts, len(children(process))), pages * os.sysconf("SC_PAGESIZE")


def check_times(rows, losses):
    """Every group of the run is there once and in order, and the breaks are marked."""
    times = np.array([float(row["time_s"]) for row in rows])
    assert np.allclose(times, SLOW_GROUP_S * (np.arange(len(rows)) + 0.5), atol=2e-6)
    absent = np.array([row["flags"] == "gap" for row in rows])
    assert np.count_nonzero(np.diff(absent.astype(int)) == 1) == losses
    first = int(np.argmax(absent))
    assert not [row for row in rows[first:] if not {"gap", "moved"} & set(row["flags"].split())]
    assert not [row for row in rows[: first - 1] if "moved" in row["flags"]]


def check_utc(rows):
    """UTC follows the time of the run over every break, whose length the host has measured."""
    utc_s = np.array([datetime.fromisoformat(row["time_utc"]).timestamp() for row in rows])
    shift_s = utc_s - np.array([float(row["time_s"]) for row in rows])
    # On a busy machine the software N210 falls behind, and its first samples come late. The error
    # of one break adds to those before.
    assert np.abs(np.diff(shift_s)).max() < 1.0


def received_s(client):
    return ask(client, "status")["time_s"]


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_live_network_cut_in_a_packet_continues_the_run_and_its_outputs(
    software_usrp, slow_scene, tmp_path
):
    device = software_usrp(slow_scene)
    output, name, (port,) = tmp_path / "out.csv", tmp_path / "run", free_ports(1)
    options = [*GAINS, "--reconnect", "-o", output, "--record", name, "--control", port]
    losses = LOSSES
    holds = []
    with live(device.args, slow_scene, *options, limit=2000) as process:
        with connected(zmq.REQ, port) as client:
            for loss in range(losses):
                wait_until(lambda: streaming_s(device) > 0.8)
                # Well above the 5 s of a loss: on a busy machine, samples come late.
                assert not device.command("fault 0 cut 8").get("error")
                wait_until(lambda: streaming_s(device) == 0.0)  # the session has ended
                wait_until(lambda gaps=loss + 1: ask(client, "status")["gaps"] == gaps)
                holds.append(held(process))
            # The clock of the tag is found, and then a tare makes the reference valid.
            wait_until(
                lambda: "opened" in ask(client, "status")["sensors"]["arm"]["reference_problem"]
            )
            wait_until(lambda: ask(client, "tare")["ok"])
            # The first group that is compared with the new reference shows it.
            wait_until(lambda: not ask(client, "status")["sensors"]["arm"]["reference_problem"])
            tared_s = received_s(client)
            wait_until(lambda: received_s(client) > tared_s + 1.2)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0
    assert said.count("; waiting for the device") >= losses
    assert said.count("is back after") == losses and "terminate" not in said
    rows = rows_of(output)
    tared = next(n for n, row in enumerate(rows) if "reference" in row["flags"] and n > 20)
    check_times(rows[:tared], losses)
    assert rows[-1]["flags"] == "" and rows[-1]["touch"] == "0"
    dropped = sum(row["flags"] == "gap" for row in rows)
    assert f"{len(rows)} groups" in said and f"{dropped} lost" in said
    assert dropped * SLOW_GROUP_S > 5.9 * losses
    # The recording is one capture, with the breaks as gaps.
    capture = open_capture(name)
    assert len(capture.segments) == losses + 1
    lost = capture.span - capture.samples
    assert lost / RATE == pytest.approx(dropped * SLOW_GROUP_S, abs=2 * losses * SLOW_GROUP_S)
    # What is held does not depend on how often the device was lost.
    assert len({counts for counts, _ in holds}) == 1
    assert holds[-1][1] - holds[9][1] < 20e6
    check_utc(rows)  # the last, since it needs a machine that is not busy


def test_live_waits_for_its_device_and_finds_one_started_again_whose_clock_does_not_matter(
    software_usrp, slow_scene, tmp_path
):
    """A service starts before the device is switched on; one that was killed while it sent aborted
    the reader about once in twenty times."""
    device = software_usrp("--air", "cable")
    device.stop()
    output = tmp_path / "out.jsonl"
    output.write_text("precious")
    options = [*GAINS, "--reconnect", "-o", output, "--log-level", "warning"]
    with live(device.args, slow_scene, *options) as process:
        assert "waiting for the device" in process.stderr.readline()
        assert output.read_text() == "precious"
        moments_s = [time.time()]
        first = software_usrp(slow_scene, address=device.address)
        wait_until(lambda: streaming_s(first) > 0.8)
        first.process.kill()
        first.process.wait()
        moments_s.append(time.time())
        second = software_usrp(slow_scene, address=device.address)
        wait_until(lambda: streaming_s(second) > 1.0)
        process.send_signal(signal.SIGINT)
        moments_s.append(time.time())
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and "terminate" not in said
    assert all(line.startswith("gr-wiforce: warning: ") for line in said.splitlines())
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    check_times(rows, 1)
    # The time of the second device begins at zero; UTC is that of its first samples all the same.
    last_absent = max(n for n, row in enumerate(rows) if row["flags"] == "gap")
    firsts_s = [
        datetime.fromisoformat(rows[n]["time_utc"]).timestamp() for n in (0, last_absent + 1)
    ]
    begun_s, lost_s, ended_s = moments_s
    assert begun_s < firsts_s[0] < lost_s < firsts_s[1] < ended_s


@pytest.mark.long
def test_live_driver_killed_is_started_again(slow_scene, slow_device, tmp_path):
    """A driver may crash or be killed for its memory, with a packet half sent."""
    output = tmp_path / "out.csv"
    with live(slow_device.args, slow_scene, *GAINS, "--reconnect", "-o", output) as process:
        wait_until(lambda: streaming_s(slow_device) > 0.8)
        (driver,) = children(process)
        os.kill(driver, signal.SIGKILL)
        wait_until(lambda: streaming_s(slow_device) < 0.8)
        wait_until(lambda: streaming_s(slow_device) > 0.8)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and said.count("SIGKILL") == 1
    check_times(rows_of(output), 1)


def test_live_reports_to_systemd(slow_scene, slow_device, tmp_path, monkeypatch):
    messages = []
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "400000")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        with live(slow_device.args, slow_scene, *GAINS, "--duration", 0.6) as process:
            while "STOPPING=1" not in messages:
                messages.append(systemd.recv(4096).decode())
            process.communicate(timeout=300)
    assert process.returncode == 0
    assert messages.count("READY=1") == 1 and "WATCHDOG=1" in messages


@pytest.mark.long
def test_live_blocked_output_is_not_taken_for_a_lost_device(slow_scene, slow_device):
    """A reader whose standard output nobody reads must not reset a working device."""
    with live(slow_device.args, slow_scene, *GAINS, "--reconnect") as process:
        os.set_blocking(process.stdout.fileno(), False)
        wait_until(lambda: streaming_s(slow_device) > 0.5)
        driver = children(process)
        # Shrunk, the pipe is full after a second of readings; a device is lost after 5 s.
        fcntl.fcntl(process.stdout.fileno(), fcntl.F_SETPIPE_SZ, 4096)
        time.sleep(7)
        assert children(process) == driver
        os.set_blocking(process.stdout.fileno(), True)
