# SPDX-License-Identifier: GPL-3.0-or-later
"""Foxglove and LSL outputs within one process: slow clients, addresses, times."""

import json
import math
import os
import socket
import time
from datetime import datetime, timezone

import pylsl
import pytest
import websockets.sync.client
from gnuradio.wiforce.io.network.foxglove_server import FoxgloveServer
from gnuradio.wiforce.io.network.lsl_outlets import CHANNELS, TIME_CHANNELS, LslOutlets
from gnuradio.wiforce.io.readings import Reading
from machine import free_port, wait_until
from ros_clients import SUBPROTOCOL, FoxgloveClient

STAMP = {"run": "r", "time_utc": "2026-01-31T23:59:59.000000Z", "device_time_s": 1.0}


@pytest.fixture
def server():
    port = free_port()
    made = FoxgloveServer(str(port), ["arm"])
    made.port = port
    yield made
    made.close()


def test_foxglove_client_that_does_not_read_delays_nobody(server):
    """A browser tab in the background must not stop the readings of the robot."""
    with websockets.sync.client.connect(
        f"ws://127.0.0.1:{server.port}", subprotocols=[SUBPROTOCOL], max_queue=1
    ) as stalled:
        channels = []
        while not channels:
            channels = json.loads(stalled.recv()).get("channels", [])
        ids = [{"id": each["id"], "channelId": each["id"]} for each in channels]
        stalled.send(json.dumps({"op": "subscribe", "subscriptions": ids}))
        client = FoxgloveClient(server.port)
        received = client.messages["/wiforce/arm/reading"]

        def heard():
            server.write(Reading(0.0, "arm", 0, group=-1), STAMP)
            return received

        wait_until(heard)
        large = STAMP | {"run": "r" * 10_000}
        for group in range(1000):  # 10 MB, more than the sockets of both hold
            server.write(Reading(0.036 * group, "arm", 1, 4.0, group=group), large)
        wait_until(lambda: received[-1].group == 999)
        stalled.socket.close()


def test_foxglove_client_that_sends_nonsense_prints_nothing(server, capfd, caplog):
    """A browser that tries again and again would fill the journal of a robot."""
    with socket.create_connection(("127.0.0.1", server.port)) as client:
        client.sendall(b"nonsense\r\n\r\n")
        assert not client.recv(1)
    assert not caplog.records and not "".join(capfd.readouterr())


def test_lsl_samples_have_the_time_of_the_measurement():
    """Streams of other devices are aligned by it; the time of arrival is a group and more later."""
    name = f"arm{os.getpid()}"
    outlets = LslOutlets([name], 0.036)
    (info,) = pylsl.resolve_byprop("name", f"gr-wiforce {name}", timeout=300)
    inlet = pylsl.StreamInlet(info, recover=False)
    inlet.open_stream(timeout=300)
    measured_s = time.time() - 0.1
    utc = datetime.fromtimestamp(measured_s, timezone.utc).isoformat()
    before_s = pylsl.local_clock()
    outlets.write(Reading(0.018, name, 1, 4.0, flags=("gap", "weak"), group=7), {"time_utc": utc})
    outlets.write(Reading(0.054, name), {"time_utc": ""})
    sample, sample_s = inlet.pull_sample(timeout=300)
    unknown, unknown_s = inlet.pull_sample(timeout=300)
    outlets.close()
    channels = CHANNELS + TIME_CHANNELS
    found = {label: value for (label, *_), value in zip(channels, sample, strict=True)}
    assert (found["force_n"], found["touch"], found["flags"], found["group"]) == (4.0, 1, 10, 7)
    assert math.isnan(found["location_mm"])
    assert sample[-2:] == [0.018, pytest.approx(measured_s, abs=1e-5)]
    assert unknown[-2] == 0.054 and math.isnan(unknown[-1])
    # Both clocks are read here and by the outlet, between which the process may wait its turn.
    assert sample_s == pytest.approx(before_s - 0.1, abs=0.02)
    assert all(math.isnan(value) for value in unknown[:9]) and unknown_s >= before_s


@pytest.mark.parametrize("network", [False, True])
def test_lsl_keeps_to_this_machine_unless_asked(monkeypatch, network):
    """Streams would be offered to a network, or not as its administrator has set."""
    given = []
    monkeypatch.setattr(pylsl, "set_config_content", given.append)
    LslOutlets([], 0.036, network=network)
    assert len(given) == (not network)
    assert all("machine" in text and "127.0.0.1" in text for text in given)
