# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene on the air of the software N210: the same channel as `simulate`, at the same levels."""

import json
import time

import numpy as np
import pytest
from gnuradio import blocks, gr, uhd
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.channel import AirChannel
from gnuradio.wiforce.scene.simulator import capture

REFERENCE_AMPLITUDE = 0.5  # of the sounding waveform, at gains of 15 dB

SCENE = {
    "sensors": [{"name": "arm", "model": "wiforce-900mhz", "off_reflection": [0.1, -0.05]}],
    "environment": {"moving_clutter_hz": 10},
    "reference_s": 0.01,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 0.06,
        "moving_clutter_db": 20,
        "presses": [
            {"start_s": 0.02, "rise_s": 0.01, "hold_s": 0.02, "force_n": 5, "location_mm": 30}
        ],
    },
}


@pytest.fixture
def scene_file(tmp_path):
    """A scene that has a bit of everything, as a file."""
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(SCENE))
    return path


def sounding(scene, gain_db=0.0):
    """Frames for the host to send: int16 I Q I Q, a few so that they hold an even number."""
    frame = scene.waveform().frame() * REFERENCE_AMPLITUDE * 10 ** (gain_db / 20)
    return np.rint(frame.view(float) * 32767).astype(np.int16)


def run(args, scene, count, path, tx_gain_db=15, rx_gain_db=15):
    """What a host receives while it sends the scene's frames; int16, shape (count, 2)."""
    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
    source, sink = uhd.usrp_source(args, stream), uhd.usrp_sink(args, stream)
    for block, gain_db in ((source, rx_gain_db), (sink, tx_gain_db)):
        block.set_samp_rate(scene.radio.sample_rate_hz)
        block.set_center_freq(scene.radio.center_frequency_hz)
        block.set_gain(gain_db)
    source.set_time_now(uhd.time_spec(0))
    source.set_start_time(uhd.time_spec(0.4))
    sink.set_start_time(uhd.time_spec(0.4))
    frames = blocks.vector_source_s(sounding(scene).tolist(), True, 2)
    head, received = blocks.head(4, count), blocks.file_sink(4, str(path))
    flowgraph = gr.top_block()
    flowgraph.connect(frames, sink)
    flowgraph.connect(source, head, received)
    flowgraph.start()
    while received.nitems_read(0) < count:
        time.sleep(0.02)
    flowgraph.stop()
    flowgraph.wait()
    received.close()
    return np.fromfile(path, np.int16).reshape(-1, 2)


def simulated(scene, count):
    pieces = np.concatenate(list(capture(scene, AirChannel(scene), "ci16_le")))
    return pieces.reshape(-1, 2)[:count]


def test_a_host_receives_what_simulate_writes(software_usrp, scene_file, tmp_path):
    scene = load_scene(scene_file)
    count = int(0.06 * 12.5e6) // 720 * 720
    device = software_usrp(scene_file, "--delay-us", 0)
    received = run(device.args, scene, count, tmp_path / "samples")
    difference = np.abs(received.astype(int) - simulated(scene, count))
    # One step of the 14-bit ADC is 4 codes; the host's rounding to 16 bits and the FPGA's scale
    # word (4e-5 of the value) move a sample by a code each.
    assert difference.max() <= 4 + 2
    assert np.mean(difference > 2) < 0.1
    status = device.command("status")
    assert status["tx_underflows"] == status["tx_late_packets"] == 0
