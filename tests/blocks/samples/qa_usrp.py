# SPDX-License-Identifier: GPL-3.0-or-later
"""Block USRP with the software N210: gains, antennas, and the common start."""

import gc
import importlib
import threading
import time
from types import SimpleNamespace

import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr, uhd, wiforce
from gnuradio.wiforce.blocks.usrp import opened, timed_frames
from gnuradio.wiforce.errors import InputError
from live_runs import FRAMES, SLOW, scene_file, wait_until
from press_capture import run_flowgraph, running
from PyQt5.QtWidgets import QDoubleSpinBox
from software_usrp import SoftwareUsrp

usrp_block = importlib.import_module("gnuradio.wiforce.blocks.usrp")
# Of the device, 250 samples; the search begins frames up to 8 samples early.
DELAY_US, EARLY = 100, 8


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """An untouched sensor, at a low rate."""
    return scene_file(tmp_path_factory.mktemp("untouched"), [], 400, 0.3, **SLOW)


@pytest.fixture(scope="module")
def software(scene):
    with SoftwareUsrp(scene, "--delay-us", DELAY_US) as device:
        yield device


@pytest.fixture(scope="module")
def device(software):
    return f"{software.args},{FRAMES}"


@pytest.fixture
def usrp(device, scene):
    return wiforce.usrp(scene, device, rx_gain=20)


def test_device_that_answers_late_is_opened():
    """A machine that was busy for 0.2 s ended a live run before its first sample."""
    answers_s = time.monotonic() + 0.5

    def find():
        time.sleep(0.1)
        if time.monotonic() < answers_s:
            raise LookupError("No devices found")
        return "device"

    assert opened(find, LookupError) == "device"
    with pytest.raises(ValueError):
        opened(lambda: float("x"), LookupError)


def test_usrp_gains_have_the_range_of_the_device(usrp, qt):
    """A B210 has 0 to 89.75 and 0 to 76 dB, an N210 with SBX 0 to 31.5 and 0 to 38 dB."""
    assert usrp.receiver.get_gain() == 20
    # A third of the range, in steps of the device.
    assert usrp.transmitter.get_gain() == pytest.approx(31.5 / 3, abs=0.5)
    usrp.set_tx_gain(10)
    assert usrp.transmitter.get_gain() == 10
    with pytest.raises(InputError, match="rx_gain: must be 0 to 38 dB with this device, got 65"):
        usrp.set_rx_gain(65)
    assert usrp.receiver.get_gain() == 20
    # So have the sliders.
    widget = usrp.gain_sliders()
    transmit, receive = widget.findChildren(QDoubleSpinBox)
    assert (transmit.minimum(), transmit.maximum()) == (0, 31.5)
    assert (receive.minimum(), receive.maximum()) == (0, 38)
    assert receive.value() == 20
    receive.setValue(7.5)
    assert usrp.receiver.get_gain() == 7.5


def test_usrp_bad_parameter_is_refused_in_one_line(device, scene):
    with pytest.raises(InputError) as refused:
        wiforce.usrp(scene, device, rx_antenna="RX3")
    assert str(refused.value) == "rx_antenna: must be one of TX/RX, RX2, CAL, got 'RX3'"
    with pytest.raises(InputError, match="^device: must be a USRP that answers") as refused:
        wiforce.usrp(scene, "type=usrp2,addr=127.255.255.254")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("direction", ["sink", "source"])
def test_usrp_that_fails_to_answer_once_is_opened(device, scene, monkeypatch, direction):
    name, errors = f"usrp_{direction}", [RuntimeError("KeyError: No devices found for ----->")]
    block = getattr(uhd, name)

    def busy(*given):
        if errors:
            raise errors.pop()
        return block(*given)

    monkeypatch.setattr(uhd, name, busy)
    assert wiforce.usrp(scene, device).receiver.get_antennas()


def test_usrp_of_another_program_is_refused(scene, monkeypatch):
    """A second program took the device away, and the first one blamed its cable."""

    def lock(args, where):
        raise InputError(where, "must name a device that is free", args)

    monkeypatch.setattr(usrp_block, "DeviceLock", lock)
    with pytest.raises(InputError, match="^device: must name a device that is free, got 'addr=1'"):
        wiforce.usrp(scene, "addr=1")


def test_usrp_both_directions_start_at_one_time_in_every_run(software, device, scene):
    """The delay from transmitter to receiver would otherwise be another one in each run."""
    usrp, offsets = wiforce.usrp(scene, device), []
    for _ in range(2):
        flowgraph = gr.top_block()
        received = blocks.null_sink(4)
        flowgraph.connect(usrp, received)
        with running(flowgraph):
            wait_until(lambda seen=received: seen.nitems_read(0) > 100_000)
        flowgraph.disconnect_all()
        offsets.append(usrp.alignment.offset)
    # The transmitter of the second run goes on within a frame.
    delay = DELAY_US * 2.5
    assert delay - EARLY <= offsets[0] <= delay
    assert offsets[1] is not None
    assert software.command("status")["streaming_s"] > 0
    del usrp, flowgraph
    gc.collect()  # blocks refer to each other
    wait_until(lambda: software.command("status")["streaming_s"] == 0)  # the device is closed


@pytest.mark.parametrize("late_s", [0.02, 0.5, 96.25])
def test_times_begin_anew_by_whole_frames_once_they_have_passed(late_s):
    """Readings of a machine that was busy once never came back: all later packets were late."""
    frame, rate, most = 50, 1000.0, 64
    items = np.arange(2 * frame, dtype=np.int16)
    answers = [(0, 0.0), (3, 0.75 + 0.2 + late_s)]

    def device_time():
        return answers.pop(0) if answers else (0, 0.0)

    timed = timed_frames(lambda: (3, 0.75), device_time, items.reshape(-1, 2), rate)
    sink = blocks.vector_sink_s(2)
    timed.set_output_multiple(1)
    timed.set_max_noutput_items(most)
    run_flowgraph(timed, blocks.head(4, 20 * frame), sink)
    assert np.array_equal(sink.data(), np.tile(items, 20))
    first, second = sink.tags()
    for tag in (first, second):
        assert pmt.symbol_to_string(tag.key) == "tx_time"
    full, part = (pmt.to_python(tag.value) for tag in (first, second))
    assert first.offset == 0 and full == (3, 0.75)
    # The second look comes a tenth of a second of samples after the first.
    begun_s, late = part[0] + part[1], 3.75 + 0.2 + late_s
    frames = (begun_s - 3.75 - second.offset / rate) * rate / frame
    assert frames == pytest.approx(round(frames), abs=1e-6) and frames > 0
    assert 0 <= begun_s - late - 0.25 <= frame / rate + 1e-9
    assert timed.skipped_s == pytest.approx(round(frames) * frame / rate)


def test_frames_say_once_that_the_device_is_lost(monkeypatch):
    """Readings ended without a word, and stopping printed addresses of memory."""
    said, statuses, answers = [], [], ["", "x", "", "x", "x"]
    log = SimpleNamespace(error=lambda text: said.append((text, len(answers))))
    monkeypatch.setattr(usrp_block.gr, "log", log)
    monkeypatch.setattr(usrp_block, "exit_on_terminate", statuses.append)
    monkeypatch.setattr(usrp_block, "PATIENCE_S", 0)

    def ask():
        if answers.pop(0):
            raise RuntimeError("no response packet")

    frames = timed_frames(lambda: (0, 0.0), ask, np.zeros((4, 2), np.int16), 1e3, watches=True)
    frames.start()
    wait_until(lambda: statuses)
    frames.stop()
    ((sentence, left),) = said
    assert "the device is lost" in sentence and left == 0 and statuses == [1]


def test_frames_that_are_stopped_ask_their_device_no_more(monkeypatch):
    """What still held the device as a program ended kept it open, which could crash the process."""
    monkeypatch.setattr(usrp_block, "PATIENCE_S", 0)
    asked, ended = threading.Event(), []

    def ask():
        asked.set()
        time.sleep(0.3)
        ended.append(True)

    frames = timed_frames(lambda: (0, 0.0), ask, np.zeros((4, 2), np.int16), 1e3, watches=True)
    frames.start()
    assert asked.wait(60)
    frames.stop()
    assert ended
    assert not [thread for thread in threading.enumerate() if thread.name == "device_watch"]
