# SPDX-License-Identifier: GPL-3.0-or-later
"""SoapySDR drivers that throw, hang or state no number (soapy_player.cc)."""

import json
import subprocess
import sys

import pytest
from gnuradio.wiforce.io.network.device_lock import DeviceLock
from live_runs import SLOW, run_session, scene_file
from wiforce_app.live import run
from wiforce_app.main import main
from wiforce_app.radio.request import DeviceLost
from wiforce_app.radio.soapy import _text

pytestmark = pytest.mark.usefixtures("soapy_player")
RATE, CARRIER = "radio.sample_rate_hz: ", "radio.center_frequency_hz: "

# What the driver does, what is asked of it besides, and what is said of it.
REFUSALS = [
    ("throws=duplex:invalid", {}, "--args: ", "duplex failed"),
    ("throws=agc:range", {}, "--args: ", "gain control can be switched off (agc failed)"),
    ("throws=time", {}, "--args: ", "time failed"),
    ("throws=rate", {}, RATE, "the device's driver accepts (rate failed), got 2500000"),
    ("throws=frequency:invalid", {}, CARRIER, "(frequency failed), got 900000000"),
    ("throws=frequency", {}, CARRIER, "(frequency failed), got 900000000"),
    ("throws=gain:invalid", {"rx_gain_db": 10}, "--rx-gain: ", "(gain failed), got 10"),
    ("throws=gain", {"tx_gain_db": 12}, "--tx-gain: ", "(gain failed), got 12"),
    ("throws=antenna", {"rx_antenna": "B"}, "--antenna: ", "(antenna failed), got 'B'"),
    ("nan=rate", {}, RATE, "nearest: nan Hz"),
    ("nan=frequency", {}, CARRIER, "must lie in the device's range"),
    ("nan=gain", {"rx_gain_db": 10}, "--rx-gain: ", "must be nan to nan dB"),
    ("throws=gain", {}, "", ""),  # not asked for
    ("nan=gain", {}, "", ""),
    ("bytes=1", {}, "", ""),
    ("time=0", {"tx_args": "driver=player,full=0"}, "", ""),
    ("full=0", {}, "--args: ", "full-duplex device: this one transmits or receives, but not both"),
    ("tx=0", {}, "--args: ", "full-duplex device: this one receives only"),
    ("time=0", {"bandwidth_hz": 2e6}, "--bandwidth: ", "this device's filter is fixed"),
    ("time=0", {"reference": "external"}, "--reference: ", "must not be given"),
    ("time=0", {"tx_antenna": "C"}, "--tx-antenna: ", "must be one of A, B, got 'C'"),
]
HANGING = """
import os, time
import numpy as np
from gnuradio import blocks, gr
from wiforce_app.radio.streams import start_flowgraph

class Source(gr.sync_block):
    def __init__(self):
        gr.sync_block.__init__(self, "hanging", None, [np.int16])
    def start(self):
        time.sleep(60)

flowgraph, source = gr.top_block(), Source()
flowgraph.connect(source, blocks.null_sink(2))
try:
    start_flowgraph(flowgraph, lambda _: {stopped}, "--args", "driver=x", limit_s=0.3)
except ValueError as error:
    os.write(2, str(error).encode())
os._exit(0)
"""


@pytest.fixture
def scene(tmp_path):
    radio = SLOW["radio"] | {"center_frequency_hz": 900e6}
    return scene_file(tmp_path, [], 400, 0.3, **SLOW | {"radio": radio})


def test_soapy_driver_that_refuses_a_setting_is_refused_by_the_name_of_the_setting(scene):
    """A driver's exception gave a traceback, or a device that is present counted as lost."""
    cases = [
        {"args": f"driver=player,n={number},{fault}", **settings}
        for number, (fault, settings, *_) in enumerate(REFUSALS)
    ]
    refusals, said = run_session("opened", scene, *map(json.dumps, cases))
    assert "Traceback" not in said
    for found, (fault, _, where, words) in zip(refusals, REFUSALS, strict=True):
        assert bool(found) == bool(words), (fault, found)
        assert where in found and words in found, (fault, found)


def test_last_line_of_a_process_that_exits_at_once_is_printed():
    """What it said of the cause was lost, as it ends without Python's own end."""
    program = (
        "import os, sys\n"
        "from wiforce_app.radio.soapy import _keep_standard_error\n"
        "_keep_standard_error()\n"
        "os.write(2, b'letters of a driver')\n"
        "print('the cause \\udcff', file=sys.stderr)\n"
        "os._exit(3)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (3, b"the cause \\udcff\n")


@pytest.mark.parametrize("stopped", [False, True])
def test_start_of_a_driver_that_hangs_ends_in_bounded_time(stopped):
    """GNU Radio waits for ever for a block that throws while it starts."""
    done = subprocess.run(
        [sys.executable, "-c", HANGING.format(stopped=stopped)],
        capture_output=True,
        text=True,
        timeout=30,
    )
    reason = "stopped before" if stopped else "has not started to stream within 0.3 s"
    assert done.stderr.startswith("--args: must name a device that can stream (")
    assert reason in done.stderr and done.stderr.endswith("got 'driver=x'")


@pytest.mark.parametrize("readings", [0, 3])
def test_live_lost_device_promises_only_readings_that_exist(scene, monkeypatch, capsys, readings):
    def lose(outputs, **_):
        outputs.rows = readings
        raise DeviceLost("the device is lost")

    monkeypatch.setattr(run, "LiveRun", lose)
    assert main(["live", "--scene", str(scene), "--args", "addr=1"]) == 1
    end = "all readings until then are kept" if readings else "there are no readings"
    assert capsys.readouterr().err == f"gr-wiforce: the device is lost; {end}\n"


def test_device_lock_takes_bytes_that_are_no_text():
    """Serial numbers of devices, and names that a resolver does not take."""
    for args in ("driver=\udcff", "addr=\udcff", "addr=a..b", f"addr={'a' * 70}"):
        lock = DeviceLock(args, handover_s=0.0)
        lock.take_serial("\udcff\udcfe")
        lock.release()
    assert _text("\udcff\udcfe") == r"\xff\xfe" and _text("N210") == "N210"
