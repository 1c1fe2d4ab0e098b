# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and requests of a live reader over ZMQ."""

import json
import signal

import zmq
from command_runs import refused, run_command, succeeded
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys
from live_runs import GAINS, free_ports, live, rows_of


def test_live_with_keys_is_for_known_clients_and_interrupted_twice_keeps_its_files(
    slow_scene, slow_device, tmp_path
):
    """Beyond loopback, whoever reaches the ports could otherwise stop a robot's reader."""
    keys = tmp_path / "keys"
    succeeded("keys", keys)
    readings_port, control_port = free_ports(2)
    options = ["--zmq", readings_port, "--control", f"tcp://0.0.0.0:{control_port}"]
    rows, messages = tmp_path / "out.csv", tmp_path / "out.mcap"
    options += ["--zmq-keys", keys, *GAINS, "-o", rows, "--mcap", messages]
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
        # Whoever waits for a radio that does not answer presses the keys again; the second signal
        # may come while the first waits, or after the end.
        for _ in range(2):
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=300)
    assert process.returncode in (0, 130)
    succeeded("export", messages, "-o", tmp_path / "again.csv")
    kept = rows_of(tmp_path / "again.csv")
    assert len(rows_of(rows)) == len(kept) > 5 and rows.read_text().endswith("\n")
