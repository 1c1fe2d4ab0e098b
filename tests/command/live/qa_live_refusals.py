# SPDX-License-Identifier: GPL-3.0-or-later
"""Devices and options that a live reader refuses, in one line each."""

import json
import socket

import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.device_lock import DeviceLock
from gnuradio.wiforce.scene import load_scene
from live_runs import command, run_session, scene_of
from long_cases import cases
from wiforce_app.radio.radio import open_radio
from wiforce_app.radio.request import RadioRequest


@pytest.mark.parametrize("name", cases("live", long=("check",)))
def test_live_and_check_without_device_name_alternatives(name):
    status, out, said = command(name, "--scene", "demo", "--args", "addr=127.0.0.254")
    assert (status, out) == (2, "") and said.count("\n") == 1
    assert all(word in said for word in ("addr=127.0.0.254", "emulate", "read"))


@pytest.mark.parametrize(
    "rate_hz, settings, rule",
    [
        (12.5e6, {"rx_gain_db": 99}, "--rx-gain: must be 0 to 38 dB with this device, got 99"),
        (11e6, {}, "scene: radio.sample_rate_hz: must be a rate that the device supports"),
    ],
)
def test_settings_that_a_usrp_does_not_have_are_refused(software_usrp, rate_hz, settings, rule):
    args = software_usrp("--air", "cable").args
    scene = load_scene(scene_of([], radio={"sample_rate_hz": rate_hz}))
    with pytest.raises(InputError, match=rule):
        open_radio(RadioRequest.of_scene(scene, args, **settings))


def test_live_outputs_that_cannot_be_opened_keep_what_is_there(tmp_path):
    """None of them waits for a device."""
    kept = [tmp_path / "run.sigmf-data", tmp_path / "kept.jsonl"]
    for path in kept:
        path.write_text("precious")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for options, words in (
            (["-o", kept[1], "--record", tmp_path / "run"], ["run.sigmf-data", "exists"]),
            (["-o", kept[1], "--zmq", port], ["--zmq", "in use"]),
            (["-o", kept[1], "--control", port], ["--control", "in use"]),
            (["-o", tmp_path / "out.txt"], ["out.txt", ".csv"]),
            (["--zmq", "ipc://x"], ["--zmq"]),
        ):
            said = refused("live", "--scene", "demo", "--args", "addr=127.0.0.254", *options)
            assert all(word in said for word in words), said
    assert all(path.read_text() == "precious" for path in kept)


def test_live_device_in_use_is_refused_and_keeps_the_file(tmp_path):
    """Two runs would lose the device to each other, with wrong readings in between."""
    output = tmp_path / "out.csv"
    output.write_text("precious")
    lock = DeviceLock("addr=127.0.0.254")
    options = ["--scene", "demo", "--args", "addr=127.0.0.254", "--reconnect", "-o", str(output)]
    (status,), said = run_session("refused", json.dumps(options))
    lock.release()
    assert status == 2 and "--args: must name a device that is free" in said
    assert output.read_text() == "precious"
