# SPDX-License-Identifier: GPL-3.0-or-later
"""backscatter_tag and sounding_source: what is sent is what their parameters say, at any time."""

import numpy as np
import pytest
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.signal.waveform import sounding_waveform
from press_capture import Run, run_flowgraph

FRAME = 720
RATE = 12.5e6
QUIET = {"snr_db": 100.0, "static_clutter_db": 20.0, "clock_offset_ppm": 0.0}


class Collector(gr.sync_block):
    """Keeps what arrives as arrays: a vector_sink's list of 10^7 samples takes its time."""

    def __init__(self):
        gr.sync_block.__init__(self, "collector", [np.complex64], None)
        self.parts = []

    def work(self, input_items, output_items):
        self.parts.append(input_items[0].copy())
        return len(input_items[0])


def run(tag, frames, amplitude=0.5):
    source, sink = wiforce.sounding_source(amplitude=amplitude), Collector()
    run_flowgraph(source, blocks.head(gr.sizeof_gr_complex, frames * FRAME), tag, sink)
    return np.concatenate(sink.parts)


def sent(frames, amplitude=0.5):
    return np.tile(amplitude * sounding_waveform().frame(), frames)


def ends(samples, amplitude=0.5, clock_hz=1000.0):
    """Lines 1 and 4 (ends 1 and 2) on each of 31 subcarriers, up to path and clock phase."""
    folded = samples.reshape(-1, FRAME)[:, 64:320].reshape(-1, 4, 64).mean(axis=1)
    reference = amplitude * sounding_waveform().preamble[:64]
    h = np.fft.fft(folded)[:, 1:32] / np.fft.fft(reference)[1:32]
    t = np.arange(len(h)) * FRAME / RATE
    window = np.kaiser(len(h), 12) / np.sum(np.kaiser(len(h), 12))
    return [(window * np.exp(-2j * np.pi * m * clock_hz * t)) @ h for m in (1, 4)]


def level_db(line):
    return 10 * np.log10(np.mean(np.abs(line) ** 2))


@pytest.mark.parametrize("amplitude", [0.1, 0.5])
def test_snr_counts_from_the_amplitude_of_the_input(amplitude):
    tag = wiforce.backscatter_tag(**QUIET | {"snr_db": 3.0}, amplitude=amplitude)
    tag.set_on(False)
    noise = run(tag, 2000, amplitude) - sent(2000, amplitude)
    line = 0.25 * np.sinc(0.25) * np.sinc(1000 * 256 / RATE)
    unit = 10 ** (-20 / 20) / line  # the tag's rho where the input has gain 1
    noise_h = np.mean(np.abs(noise) ** 2) * 62 / 256 / amplitude**2
    assert 10 * np.log10((unit * line) ** 2 / noise_h) == pytest.approx(3.0, abs=0.1)


def test_force_and_location_turn_the_ends_as_the_sensor_model_says():
    model = load_sensor("line-900mhz")
    before = ends(run(wiforce.backscatter_tag(**QUIET), 2500))
    after = ends(run(wiforce.backscatter_tag(**QUIET, force_n=4.0, location_mm=30.0), 2500))
    turned = model.phases_deg(4.0, 30.0) - model.untouched_deg()
    wanted = np.exp(1j * np.deg2rad(turned))
    # Line 1 is end 1 alone. On line 4 end 1 has nothing: c1[4] = 0.
    for seen, turn in zip(np.divide(after, before), wanted, strict=True):
        assert abs(np.angle(np.mean(seen / turn), deg=True)) < 0.2


def test_clock_offset_that_is_set_moves_the_lines():
    tag = wiforce.backscatter_tag(**QUIET)
    run(tag, 20)  # a second run of the flowgraph goes on
    tag.set_clock_offset_ppm(1000.0)  # is taken over by the running block
    received = run(tag, 9000)[FRAME * 500 :]
    # Line 4 is 3.11 dB below line 1, and moves by four times as much: 4 Hz.
    assert level_db(ends(received, clock_hz=1001.0)[1]) == pytest.approx(-23.1, abs=0.1)
    assert level_db(ends(received, clock_hz=1000.0)[1]) < -26


def test_bad_values_set_while_running_are_refused_and_leave_all_as_it_was():
    tag = wiforce.backscatter_tag(force_n=2.0)
    with pytest.raises(ValueError, match="force_n: must be from 0 to 1000, got -3"):
        tag.set_force_n(-3)
    with pytest.raises(ValueError, match="location_mm: must be from 0 to 80, got 90"):
        tag.set_location_mm(90)
    with pytest.raises(ValueError, match="clock_offset_ppm"):
        tag.set_clock_offset_ppm(25000)
    assert (tag.force_n(), tag.location_mm()) == (2.0, 40.0)


def test_effects_act_in_a_flowgraph_and_may_not_repeat_parameters():
    plain = run(wiforce.backscatter_tag(**QUIET), 50)
    rippling = run(
        wiforce.backscatter_tag(**QUIET, effects={"ripple": {"percent": 20, "hz": 1000}}), 50
    )
    loud = np.abs(plain) > 0.2
    gain = (rippling[loud] / plain[loud]).real
    assert (gain.min(), gain.max()) == (pytest.approx(0.8, abs=2e-3), pytest.approx(1.2, abs=2e-3))
    for wrong in ({"snr_db": 3}, {"presses": []}):
        with pytest.raises(wiforce.errors.InputError, match="effects: must not hold"):
            wiforce.backscatter_tag(effects=wrong)
    with pytest.raises(wiforce.errors.InputError, match="simulation.lamp: is not a known key"):
        wiforce.backscatter_tag(effects={"lamp": {}})


def test_frames_follow_each_other_and_sc16_has_full_scale_32767():
    sink = blocks.vector_sink_s(2)
    source = wiforce.sounding_source(item_type="sc16", amplitude=0.5)
    run_flowgraph(source, blocks.head(4, 2 * FRAME), sink)
    floats = Run(wiforce.sounding_source(amplitude=0.5), blocks.head(8, 2 * FRAME)).items.ravel()
    np.testing.assert_allclose(floats, sent(2), atol=1e-7)
    np.testing.assert_allclose(sink.data(), floats.view(np.float32) * 32767, atol=0.51)


def test_amplitude_can_change_and_never_beyond_full_scale():
    source = wiforce.sounding_source()
    source.set_amplitude(0.1)
    power = np.mean(np.abs(Run(source, blocks.head(8, 320)).items) ** 2)
    assert power == pytest.approx(0.01, rel=1e-5)
    with pytest.raises(ValueError, match="amplitude: must be above 0 and at most"):
        source.set_amplitude(1.1)
