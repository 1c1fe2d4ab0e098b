# SPDX-License-Identifier: GPL-3.0-or-later
"""MCAP, Foxglove, LSL and Parquet of a live run hold the readings of its file."""

import json
import math
import os
import signal
import threading

import numpy as np
import pandas
import pylsl
import pytest
from gnuradio.wiforce.io.network.lsl_outlets import CHANNELS
from gnuradio.wiforce.io.readings import flag_bits
from live_runs import GAINS, SLOW, free_ports, live, rows_of, scene_of, wait_until
from mcap.reader import make_reader
from ros_clients import FoxgloveClient, bag_messages

SENSOR = f"arm{os.getpid()}"  # the only one of this name that LSL finds on this machine
PRESSED = 10  # readings of the press, at least


class LslRecorder:
    """Receives the samples of a stream until it ends."""

    def __init__(self, name):
        self.samples, self.info, self.correction_s = [], None, None
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
        self.info, self.correction_s = inlet.info(), inlet.time_correction()
        try:
            while not self._ended.is_set():
                values, time_s = inlet.pull_sample(timeout=0.2)
                if values is not None:
                    self.samples.append((time_s, values))
        except pylsl.util.LostError:
            pass  # the outlet is gone: all has been received


def number(text):
    return float(text) if text else math.nan


def check_readings(messages, rows):
    """PressReading messages against rows of the file."""
    assert len(messages) == len(rows)
    for message, row in zip(messages, rows, strict=True):
        for name in ("time_s", "force_n", "force_std_n", "location_mm", "location_std_mm"):
            assert np.array_equal(getattr(message, name), number(row[name]), equal_nan=True)
        for name in ("phase1_deg", "phase2_deg", "snr_db", "interference"):
            assert np.array_equal(getattr(message, name), number(row[name]), equal_nan=True)
        assert message.touch == (int(row["touch"]) if row["touch"] else -1)
        assert list(message.flags) == row["flags"].split()
        assert message.flag_bits == flag_bits(tuple(message.flags))
        assert (message.sensor, message.run) == (row["sensor"], row["run"])
        assert message.group == int(row["group"])


def check_wrenches(wrenches, rows):
    """Wrench messages against rows of the file that are touched or not."""
    assert len(wrenches) == len(rows)
    for message, row in zip(wrenches, rows, strict=True):
        force_n, place_mm = (number(row[name] or "0") for name in ("force_n", "location_mm"))
        assert message.header.frame_id == SENSOR
        assert message.wrench.force.z == -force_n
        assert message.wrench.torque.y == pytest.approx(force_n * place_mm / 1000)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    content = scene_of([], 400, 0.3, **SLOW)
    content["sensors"][0]["name"] = SENSOR
    path = tmp_path_factory.mktemp("outputs") / "scene.yaml"
    path.write_text(json.dumps(content))
    return path


def test_live_outputs_all_hold_the_readings_of_the_file(scene, software_usrp, tmp_path):
    """The run is ended by SIGTERM, as a service manager does."""
    device, (foxglove,) = software_usrp(scene), free_ports(1)
    output, bag = tmp_path / "out.csv", tmp_path / "out.mcap"
    options = [*GAINS, "-o", output, "--mcap", bag, "--foxglove", foxglove, "--lsl"]
    pylsl.set_config_content("[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n")

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
    client.join()
    recorder.join()
    rows = rows_of(output)
    assert sum(row["touch"] == "1" for row in rows) > PRESSED
    check_bag(bag, rows)
    received = client.messages[f"/wiforce/{SENSOR}/reading"]
    assert len(received) > len(rows) / 2
    check_readings(received, rows[-len(received) :])
    assert client.messages["/diagnostics"][-1].status[0].message == "ended: signal"
    check_samples(recorder, rows)


def check_bag(bag, rows):
    """By rosbags and, of its index, by mcap."""
    topic, found = f"/wiforce/{SENSOR}", bag_messages(bag)
    check_readings(found[f"{topic}/reading"], rows)
    flagged = [row for row in rows if row["flags"]]
    check_wrenches(found[f"{topic}/wrench"], [row for row in rows if not row["flags"]])
    assert len(found[f"{topic}/wrench_doubtful"]) == len(flagged) > 0
    stamps = [message.header.stamp for message in found[f"{topic}/reading"]]
    utc = pandas.to_datetime([row["time_utc"] for row in rows]).astype("int64")
    assert [each.sec * 10**9 + each.nanosec for each in stamps] == list(utc)
    health = found["/diagnostics"]
    assert health[-1].status[0].message == "ended: signal" and len(health) >= 2
    with open(bag, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        described = next(reader.iter_metadata()).metadata
        assert reader.get_header().profile == "ros2"
    assert summary.statistics.message_count == 2 * len(rows) + len(health)
    assert SENSOR in described["wiforce:scene"] and SENSOR in described["wiforce:sensors"]


def check_samples(recorder, rows):
    """Samples of LSL: values, times and description."""
    assert len(recorder.samples) > len(rows) / 2
    rows = rows[-len(recorder.samples) :]
    values = np.array([values for _, values in recorder.samples])
    for index, (name, *_) in enumerate(CHANNELS):
        column = [row[name] for row in rows]
        if name == "flags":
            expected = [flag_bits(tuple(text.split())) for text in column]
        else:
            expected = list(map(number, column))
        assert np.array_equal(values[:, index], np.array(expected, float), equal_nan=True), name
    utc = pandas.to_datetime([row["time_utc"] for row in rows]).astype("int64") / 1e9
    offsets = np.array([time_s for time_s, _ in recorder.samples]) - np.array(utc)
    # Both clocks are those of this machine, read one after the other.
    assert np.ptp(offsets) < 1e-2 and abs(recorder.correction_s) < 0.1
    info = recorder.info
    assert info.get_channel_labels() == [name for name, *_ in CHANNELS]
    assert info.get_channel_units() == [unit for _, unit, _ in CHANNELS]
    assert info.nominal_srate() == pytest.approx(1 / 0.032)
    assert SENSOR in info.desc().child("acquisition").child_value("scene")
