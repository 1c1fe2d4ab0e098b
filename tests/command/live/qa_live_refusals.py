# SPDX-License-Identifier: GPL-3.0-or-later
"""Devices and options that a live reader refuses, in one line each."""

import json
import socket

import pytest
from live_runs import command, run_session, scene_of
from long_cases import cases


@pytest.mark.parametrize("name", cases("live", long=("check",)))
def test_live_and_check_without_device_name_alternatives(name):
    status, out, said = command(name, "--scene", "demo", "--args", "addr=127.0.0.254")
    assert (status, out) == (2, "") and said.count("\n") == 1
    assert all(word in said for word in ("addr=127.0.0.254", "emulate", "read"))


def test_live_impossible_settings_refused_in_one_line(software_usrp, tmp_path):
    device = software_usrp("--air", "cable")
    demo = ["--scene", "demo", "--args", device.args]
    odd_rate = scene_of([], radio={"sample_rate_hz": 11e6})
    (tmp_path / "rate.yaml").write_text(json.dumps(odd_rate))
    kept = [tmp_path / "run.sigmf-data", tmp_path / "kept.jsonl"]
    for path in kept:
        path.write_text("precious")
    demo_again = [*demo, "-o", kept[1]]
    taken = socket.create_server(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    cases = [
        (
            ["--scene", tmp_path / "rate.yaml", "--args", device.args],
            ["sample_rate_hz", "11000000"],
        ),
        ([*demo, "--rx-gain", 99], ["--rx-gain", "38"]),
        ([*demo, "--antenna", "J1"], ["--antenna", "RX2"]),
        ([*demo, "--reference", "sun"], ["--reference", "internal"]),
        ([*demo_again, "--record", tmp_path / "run"], ["run.sigmf-data", "exists"]),
        ([*demo_again, "--zmq", port], ["--zmq", "in use"]),
        ([*demo_again, "--control", port], ["--control", "in use"]),
        ([*demo, "-o", tmp_path / "out.txt"], ["out.txt", ".csv"]),
        ([*demo, "--zmq", "ipc://x"], ["--zmq"]),
        ([*demo, "--amplitude", 0.99], ["amplitude"]),
    ]
    # One process for all of them: starting it takes longer than what it does.
    with taken:
        requests = [json.dumps(case, default=str) for case, _ in cases]
        statuses, said = run_session("refused", *requests)
    assert statuses == [2] * len(cases)
    for line, (_, words) in zip(said.splitlines(), cases, strict=True):
        assert all(word in line for word in words), line
    assert all(path.read_text() == "precious" for path in kept)
    assert not list(tmp_path.glob("*.csv"))
