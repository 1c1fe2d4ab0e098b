# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and requests of a live reader over ZMQ."""

import csv
import json
import signal
import socket

import numpy as np
import pytest
import zmq
from command_runs import refused, run_command, succeeded
from fuzzing import LIMIT_BYTES, peak_memory
from gnuradio.wiforce.io.network.zmq_keys import ClientKeys
from live_runs import GAINS, SLOW_GROUP_S, ask, connected, free_ports, live, rows_of, wait_until
from mutations import mutated


def send_broken_requests(port, count, seed):
    """Sends so many, some in several parts, some too long; and a few from what speaks no ZMQ."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", port)) as stranger:
            stranger.sendall(rng.bytes(200))
    with connected(zmq.DEALER, port) as client, connected(zmq.DEALER, port) as cut_off:
        while count > 0:
            burst = min(count, 500)  # below what a socket keeps
            answers = 0
            for number in range(burst):
                request = mutated(b"status tare", rng)
                if len(request) > 4096:
                    cut_off.send_multipart([b"", request])
                    continue
                client.send_multipart([b"", request, *[b"status"] * (number % 3)])
                answers += 1
            for _ in range(answers):
                answer = json.loads(client.recv_multipart()[-1])
                assert answer["ok"] or "must be one of" in answer["error"], answer
            count -= burst


def test_live_interrupted_twice_keeps_its_files(slow_scene, slow_device, tmp_path):
    """Whoever waits for a radio that does not answer presses the keys again."""
    (port,) = free_ports(1)
    rows, messages = tmp_path / "out.csv", tmp_path / "out.mcap"
    options = [*GAINS, "--control", port, "-o", rows, "--mcap", messages]
    with (
        live(slow_device.args, slow_scene, *options) as process,
        connected(zmq.REQ, port) as client,
    ):
        wait_until(lambda: ask(client, "status")["time_s"] >= 0.5)
        for _ in range(2):  # the second may come while the first waits, or after the end
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=300)
    assert process.returncode in (0, 130)
    succeeded("export", messages, "-o", tmp_path / "again.csv")
    kept = rows_of(tmp_path / "again.csv")
    assert len(kept) > 5 and len(rows_of(rows)) == len(kept)
    assert rows.read_text().endswith("\n")


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_live_fuzzed_requests_leave_readings_complete(slow_scene, slow_device):
    (port,) = free_ports(1)
    with (
        live(slow_device.args, slow_scene, *GAINS, "--control", port, limit=900) as process,
        connected(zmq.REQ, port) as client,
    ):
        ask(client, "status")  # it listens
        send_broken_requests(port, 10_000, seed=3)
        fuzzed_s = ask(client, "status")["time_s"]
        wait_until(lambda: ask(client, "status")["time_s"] >= max(fuzzed_s, 0.5) + 0.3)
        peak = peak_memory(process.pid)
        process.send_signal(signal.SIGINT)
        output, said = process.communicate(timeout=300)
    assert process.returncode == 0 and said.startswith("gr-wiforce: read ")
    assert peak < LIMIT_BYTES
    read_s = float(said.split()[2])
    rows = list(csv.DictReader(output.splitlines()))
    assert abs(len(rows) - read_s / SLOW_GROUP_S) <= 2
    assert f"{len(rows)} groups: {sum(not row['flags'] for row in rows)} usable" in said


def test_live_with_keys_lets_only_known_clients_read_ask_and_tare(
    slow_scene, slow_device, tmp_path
):
    """Beyond loopback, whoever reaches the ports could otherwise stop a robot's reader."""
    keys = tmp_path / "keys"
    succeeded("keys", keys)
    readings_port, control_port = free_ports(2)
    options = ["--zmq", readings_port, "--control", f"tcp://0.0.0.0:{control_port}"]
    options += ["--zmq-keys", keys, "-o", tmp_path / "out.csv"]
    with (
        live(slow_device.args, slow_scene, *options) as process,
        zmq.Context() as context,
        context.socket(zmq.SUB) as known,
        context.socket(zmq.SUB) as unknown,
    ):
        ClientKeys.load(keys).apply(known)
        for subscriber in (known, unknown):
            subscriber.setsockopt(zmq.RCVTIMEO, 60_000)
            subscriber.connect(f"tcp://127.0.0.1:{readings_port}")
            subscriber.subscribe('{"message": "reading"')
        assert json.loads(known.recv())["sensor"] == "arm"
        done = run_command("status", control_port, "--zmq-keys", keys, "--timeout", 30)
        assert done.returncode in (0, 1) and done.stdout.startswith("run ")
        assert "--zmq-keys: " in refused("status", control_port)
        assert not unknown.poll(0)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and "tare" not in said
