# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene on the air of the software N210: the same channel as `simulate`, at the same levels."""

import json
import time
from types import SimpleNamespace

import numpy as np
import pytest
from gnuradio import blocks, gr, uhd
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import capture
from software_n210.device import parse_fault
from software_n210.scene_air import SceneAir

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

EFFECTS = {
    "bursts": {"share": 0.3},
    "front_end": {"receiver_gain_db": 0.3, "transmitter_phase_deg": 2, "compression": 0.01},
    "lamps": {},
    "walker": {},
    "tags": [{"clock_jitter_s": 1e-6, "drift_deg_per_sqrt_s": 30}],
}


@pytest.fixture
def scene_file(tmp_path):
    """A scene that has a bit of everything, as a file."""
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(SCENE))
    return path


def run(args, scene, count, path):
    """What a host receives while it sends the scene's frames; int16, shape (count, 2)."""
    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
    source, sink = uhd.usrp_source(args, stream), uhd.usrp_sink(args, stream)
    for block in (source, sink):
        block.set_samp_rate(scene.radio.sample_rate_hz)
        block.set_center_freq(scene.radio.center_frequency_hz)
        block.set_gain(15)
    source.set_time_now(uhd.time_spec(0))
    for block in (source, sink):  # far enough ahead for a busy machine
        block.set_start_time(uhd.time_spec(3.0))
    frame = np.rint(scene.waveform().frame().view(float) * REFERENCE_AMPLITUDE * 32767)
    frames = blocks.vector_source_s(frame.astype(int).tolist(), True, 2)
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


def test_scene_air_host_receives_what_simulate_writes(software_usrp, scene_file, tmp_path):
    imperfect = SCENE | {"simulation": SCENE["simulation"] | EFFECTS}
    scene_file.write_text(json.dumps(imperfect))
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


class Connectors:
    """A scene's air with the device around it replaced by plain values."""

    def __init__(self, scene, delay_ticks=0):
        self.air = SceneAir(scene, delay_ticks)
        self.front_end = self.air.front_end = SimpleNamespace(
            tx_gain_db=15.0,
            rx_gain_db=15.0,
            tx_carrier_hz=900e6 + 0.02,  # as the driver leaves it, rounded to its CORDIC's step
            to_receive_carrier=lambda samples, *_: samples,
        )
        self.chain = SimpleNamespace(stream_start=4000)

    def send(self, samples, spacing=8):
        self.air.transmit(4000, spacing, samples.astype(np.complex64))

    def receive(self, count, first=0, spacing=8):
        """Codes I Q I Q, as the ADC gives them."""
        tick = 4000 + first * spacing
        samples = self.air.receive(self.chain, tick, spacing, count)
        return np.rint(samples.view(np.float32) * 32767).astype(int)


@pytest.fixture
def scene(scene_file):
    return load_scene(scene_file)


def frames(scene, count):
    return np.tile(scene.waveform().frame(), count) * REFERENCE_AMPLITUDE


def rms(codes):
    return np.sqrt(np.mean(codes.astype(float) ** 2))


def test_scene_air_transmit_gain_scales_signal_receive_gain_noise_too(scene):
    levels = {}
    for tx_db, rx_db in ((15, 15), (5, 15), (15, 5), (-100, 15), (-100, 5)):
        device = Connectors(scene)
        device.front_end.tx_gain_db, device.front_end.rx_gain_db = tx_db, rx_db
        device.send(frames(scene, 20))
        levels[tx_db, rx_db] = 20 * np.log10(rms(device.receive(7200)))
    # The static path is far above the noise, so that both gains move it by their 10 dB. The
    # noise follows the receive gain only; near one step of the ADC it can't follow exactly.
    assert levels[5, 15] - levels[15, 15] == pytest.approx(-10, abs=0.05)
    assert levels[15, 5] - levels[15, 15] == pytest.approx(-10, abs=0.05)
    noise = AirChannel(scene).noise_std / np.sqrt(2) * 32768
    quantized = np.sqrt(noise**2 + 4**2 / 12)
    assert levels[-100, 15] == pytest.approx(20 * np.log10(quantized), abs=0.2)
    assert levels[-100, 5] < levels[-100, 15] - 3


@pytest.mark.parametrize("spacing, carrier_hz", [(10, 900e6), (8, 905e6)])
def test_scene_air_at_another_rate_or_carrier_gives_noise_only(scene, spacing, carrier_hz):
    """A host with wrong settings would read a sensor that does not exist there."""
    levels = []
    for hertz, amplitude in ((900e6, 0), (carrier_hz, 1)):
        device = Connectors(scene)
        device.front_end.tx_carrier_hz = hertz
        device.send(amplitude * frames(scene, 20), spacing)
        levels.append(rms(device.receive(7200, spacing=spacing)))
    assert levels[1] == pytest.approx(levels[0], rel=0.05) and levels[0] > 0


def test_scene_air_faults_act_on_the_named_sensor(scene):
    device = Connectors(scene)
    device.receive(1)
    tag = device.air.sensor("arm")
    for kind in ("off", "on"):
        parse_fault(f"0 {kind} arm").apply(device)
        assert tag.on == (kind == "on")
    with pytest.raises(InputError, match="sensor: must be one of the scene's"):
        device.air.sensor("leg")


def test_emulate_accepts_lines(software_usrp, scene_file):
    device = software_usrp(scene_file)
    answer = device.command("press arm 4.0 45.0")
    assert answer["ok"] and "this press ends when one starts" in answer["note"]
    assert device.command("status")["sensors"]["arm"]["force_n"] == 4.0
    answer = device.command("press arm 400 45")
    assert answer["ok"] and "400 N at 45 mm leave the span" in answer["note"]
    assert "in newtons; no reader is connected" in answer["note"]
    assert device.command("release arm") == {"ok": True}
    for line, rule in (
        ("dance", "must be one of: press SENSOR"),
        ("press leg 1 1", "must be one of the scene's"),
        ("press arm 4", "must have the form: press SENSOR"),
        ("press arm x 45", "with a decimal point"),
        ("press arm -1 45", "the force must be 0 to 1000 N, got -1"),
        ("press arm 4 450", "must be 0 to 80 mm, the length of arm, got 450"),
        ("fault 1 off leg", "must be one of the scene's"),
        ("stop now", "must have the form: stop"),
    ):
        answer = device.command(line)
        assert answer["ok"] is False and rule in answer["error"]
    assert device.command("status")["sensors"]["arm"]["touch"] is False
    assert device.command("fault 1e9 off arm") == {"ok": True}
    assert device.command("stop") == {"ok": True}
    assert device.stop()[0] == 0
