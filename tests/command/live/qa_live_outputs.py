# SPDX-License-Identifier: GPL-3.0-or-later
"""MCAP, Foxglove, LSL and Parquet of a live run hold the readings of its file."""

import json
import os
import signal
import socket
import threading
from datetime import datetime

import numpy as np
import pylsl
import pytest
from live_runs import GAINS, SLOW, SLOW_GROUP_S, free_ports, live, rows_of, scene_of, wait_until
from ros_clients import FoxgloveClient, bag_messages

SENSOR = f"arm{os.getpid()}"  # the only one of this name that LSL finds on this machine
PRESSED = 10  # readings of the press, at least


class LslRecorder:
    """Receives the samples of a stream until it ends."""

    def __init__(self, name):
        self.samples, self.info = [], None
        self._name, self._ended = name, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self):
        self._ended.set()
        self._thread.join(30)
        assert not self._thread.is_alive()

    def _run(self):
        streams = pylsl.resolve_byprop("name", self._name, timeout=300)
        inlet = pylsl.StreamInlet(streams[0], recover=False)
        self.info = inlet.info()
        try:
            while not self._ended.is_set():
                values, time_s = inlet.pull_sample(timeout=0.2)
                if values is not None:
                    self.samples.append((time_s, values))
        except pylsl.util.LostError:
            pass  # the outlet is gone: all has been received


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    content = scene_of([], 400, 0.3, **SLOW)
    content["sensors"][0]["name"] = SENSOR
    path = tmp_path_factory.mktemp("outputs") / "scene.yaml"
    path.write_text(json.dumps(content))
    return path


def test_live_outputs_all_hold_the_readings_of_the_file(
    scene, software_usrp, tmp_path, monkeypatch
):
    """The run is ended by SIGTERM, as a service manager does, which hears of it."""
    device, (foxglove,) = software_usrp(scene), free_ports(1)
    output, bag = tmp_path / "out.csv", tmp_path / "out.mcap"
    lines = tmp_path / "out.jsonl"
    options = [*GAINS, "-o", output, "-o", lines, "--mcap", bag, "--foxglove", foxglove, "--lsl"]
    pylsl.set_config_content("[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n")

    systemd = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")

    def pressed():
        return output.exists() and sum(row["touch"] == "1" for row in rows_of(output))

    with live(device.args, scene, *options) as process:
        client, recorder = FoxgloveClient(foxglove), LslRecorder(f"gr-wiforce {SENSOR}")
        wait_until(lambda: output.exists() and len(rows_of(output)) > 20)
        device.command(f"press {SENSOR} 4.0 45.0")
        wait_until(lambda: pressed() > PRESSED)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    heard = [systemd.recv(4096) for _ in range(3)]
    assert heard[:2] == [b"WATCHDOG=1", b"READY=1"] and heard[2] in (b"WATCHDOG=1", b"STOPPING=1")
    systemd.close()
    client.join()
    recorder.join()
    rows = rows_of(output)
    assert sum(row["touch"] == "1" for row in rows) > PRESSED
    written = [json.loads(line) for line in lines.read_text().splitlines()]
    assert [(str(row["time_s"]), row["time_utc"]) for row in written] == [
        (row["time_s"], row["time_utc"]) for row in rows
    ]
    # What the messages hold is tested where they are made.
    topic, found = f"/wiforce/{SENSOR}", bag_messages(bag)
    times = [float(row["time_s"]) for row in rows]
    assert [message.time_s for message in found[f"{topic}/reading"]] == times
    flagged = sum(bool(row["flags"]) for row in rows)
    assert len(found[f"{topic}/wrench"]) == len(rows) - flagged
    assert len(found[f"{topic}/wrench_doubtful"]) == flagged > 0
    received = [message.time_s for message in client.messages[f"{topic}/reading"]]
    assert len(received) > len(rows) / 2 and received == times[-len(received) :]
    for messages in (found, client.messages):
        assert messages["/diagnostics"][-1].status[0].message == "ended: signal"
    assert len(recorder.samples) > len(rows) / 2
    channel = recorder.info.get_channel_labels().index("force_n")
    force_n = [values[channel] for _, values in recorder.samples]
    expected = [float(row["force_n"] or "nan") for row in rows[-len(force_n) :]]
    assert np.array_equal(force_n, expected, equal_nan=True)
    # Both clocks are those of this machine, read one after the other.
    utc_s = [datetime.fromisoformat(row["time_utc"]).timestamp() for row in rows[-len(force_n) :]]
    assert np.ptp([time_s for time_s, _ in recorder.samples] - np.array(utc_s)) < 1e-2
    assert [tuple(values[-2:]) for _, values in recorder.samples] == [
        (float(row["time_s"]), s) for row, s in zip(rows[-len(utc_s) :], utc_s, strict=True)
    ]
    described = recorder.info.desc().child("acquisition")
    assert {described.child_value("run")} == {row["run"] for row in rows}
    assert recorder.info.nominal_srate() == pytest.approx(1 / SLOW_GROUP_S)
