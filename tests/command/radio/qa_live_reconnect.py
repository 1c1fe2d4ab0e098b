# SPDX-License-Identifier: GPL-3.0-or-later
"""Live runs that go on when the device, the network or the driver fails."""

import fcntl
import json
import os
import signal
import time
from datetime import datetime

import numpy as np
import pytest
from live_runs import (
    GAINS,
    SLOW_GROUP_S,
    live,
    rows_of,
    streaming_s,
    wait_until,
)
from machine import children


def check_times(rows, losses):
    """Every group of the run is there once and in order, and the breaks are marked."""
    times = np.array([float(row["time_s"]) for row in rows])
    assert np.allclose(times, SLOW_GROUP_S * (np.arange(len(rows)) + 0.5), atol=2e-6)
    absent = np.array([row["flags"] == "gap" for row in rows])
    assert np.count_nonzero(np.diff(absent.astype(int)) == 1) == losses
    first = int(np.argmax(absent))
    assert not [row for row in rows[first:] if not {"gap", "moved"} & set(row["flags"].split())]
    assert not [row for row in rows[: first - 1] if "moved" in row["flags"]]


def killed_and_started_again(software_usrp, device, scene):
    """Another device at the address of one that is killed while it sends."""
    device.process.kill()
    device.process.wait()
    return software_usrp(scene, address=device.address)


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
        moments_s.append(time.time())
        second = killed_and_started_again(software_usrp, first, slow_scene)
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
def test_soapy_device_lost_is_opened_again_on_the_frames_that_it_had(
    software_usrp, slow_scene, tmp_path
):
    """Its streams start apart, so that the frames come at another sample each time."""
    first, output = software_usrp(slow_scene), tmp_path / "out.csv"
    options = ["--driver", "soapy", *GAINS, "--reconnect", "-o", output]
    with live(f"driver=uhd,{first.args}", slow_scene, *options) as process:
        wait_until(lambda: streaming_s(first) > 0.9)
        second = killed_and_started_again(software_usrp, first, slow_scene)
        wait_until(lambda: streaming_s(second) > 1.4)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and "terminate" not in said
    assert "is back after" in said and "frame timing" not in said
    rows = rows_of(output)
    check_times(rows, 1)
    # The tag is received again, as well as before.
    snr_db = np.array([float(row["snr_db"] or "nan") for row in rows])
    lost = next(n for n, row in enumerate(rows) if row["flags"] == "gap")
    assert np.nanmean(snr_db[-5:]) == pytest.approx(np.nanmean(snr_db[:lost]), abs=1)


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
