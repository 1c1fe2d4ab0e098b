# SPDX-License-Identifier: GPL-3.0-or-later
"""Devices and options that a live reader refuses, in one line each."""

import os
import socket
from types import SimpleNamespace

import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from live_runs import scene_of
from long_cases import cases
from wiforce_app.radio import link
from wiforce_app.radio.radio import open_radio
from wiforce_app.radio.request import RadioRequest


@pytest.mark.parametrize("name", cases("live", long=("check",)))
def test_live_and_check_without_device_name_alternatives(name):
    said = refused(name, "--scene", "demo", "--args", "addr=127.0.0.254")
    assert all(word in said for word in ("addr=127.0.0.254", "emulate", "read"))


NEEDS = "needs reader_clock: free and receive_antennas: 2 under environment in the scene"
NO_TEXT = "must be text in UTF-8, got '"


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--receive-only"], f"--receive-only: {NEEDS}"),
        (["--tx-args", "x"], f"--tx-args: {NEEDS}, or one clock for both devices (--reference ext"),
        (["--tx-args", "x", "--receive-only"], "--receive-only: must be given without --tx-args"),
        (["--args", "driver=\udcff"], f"--args: {NO_TEXT}"),
        (["--antenna", "\udcff"], f"--antenna: {NO_TEXT}"),
        (["--tx-args", "driver=\udcfe"], f"--tx-args: {NO_TEXT}"),
    ],
)
def test_live_options_that_no_radio_can_follow_are_refused(words, rule):
    assert rule in refused("live", "--scene", "demo", "--args", "addr=1", *words)


def test_settings_that_a_usrp_does_not_have_are_refused(software_usrp):
    args = software_usrp("--air", "cable").args
    for rate_hz, settings, rule in (
        (12.5e6, {"rx_gain_db": 99}, "--rx-gain: must be 0 to 38 dB with this device, got 99"),
        (11e6, {}, "scene: radio.sample_rate_hz: must be a rate that the device supports"),
    ):
        scene = load_scene(scene_of([], radio={"sample_rate_hz": rate_hz}))
        with pytest.raises(InputError, match=rule):
            open_radio(RadioRequest.of_scene(scene, args, **settings))


def test_live_outputs_that_cannot_be_opened_keep_what_is_there(tmp_path):
    """None of them waits for a device."""
    kept = [tmp_path / "run.sigmf-data", tmp_path / "kept.jsonl"]
    for path in kept:
        path.write_text("precious")
    pipe, unread = tmp_path / "pipe.csv", tmp_path / "unread.csv"
    os.mkfifo(pipe)
    os.mkfifo(unread)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for options, words in (
            (["-o", kept[1], "--record", tmp_path / "run"], ["run.sigmf-data", "exists"]),
            # Not after a wait for a reader of the pipe.
            (["-o", unread, "--record", tmp_path / "run"], ["run.sigmf-data", "exists"]),
            (["-o", unread, "--control", port], ["--control", "in use"]),
            (["-o", pipe, "-o", kept[1], "--zmq", port], ["--zmq", "in use"]),
            (["-o", pipe, "-o", tmp_path / "out.txt"], ["out.txt", ".csv"]),
            (["-o", kept[1], "--control", port], ["--control", "in use"]),
            (["-o", kept[1], "--foxglove", port], ["--foxglove: cannot be bound", "in use"]),
            (["-o", kept[1], "--web", port], ["--web: cannot be opened (Address already in use)"]),
            (["--zmq", "ipc://x"], ["--zmq"]),
        ):
            said = refused("live", "--scene", "demo", "--args", "addr=127.0.0.254", *options)
            assert all(word in said for word in words), said
    assert all(path.read_text() == "precious" for path in kept)
    assert os.read(reader, 100) == b""
    os.close(reader)


@pytest.mark.parametrize("taken", ["addr=1", "addr=2", "serial 1", "serial 2"])
def test_process_of_a_radio_uses_no_device_that_another_one_uses(monkeypatch, taken):
    """Two runs would lose the device to each other, or transmit by one device."""

    class Lock:
        def __init__(self, args, where="--args"):
            self.where = where
            self.take_serial(args)

        def take_serial(self, name):
            if name == taken:
                raise InputError(self.where, "must name a device that is free", name)

    monkeypatch.setattr(link, "DeviceLock", Lock)
    radio = SimpleNamespace(serials=["serial 1", "serial 2"])
    monkeypatch.setattr("wiforce_app.radio.radio.open_radio", lambda request: radio)
    request = RadioRequest.of_scene(load_scene("demo"), "addr=1", tx_args="addr=2")
    option = "--args" if taken.endswith("1") else "--tx-args"
    with pytest.raises(InputError, match=f"^{option}: must name a .* free, got '{taken}'"):
        link._serve(SimpleNamespace(recv=lambda: request), None)
