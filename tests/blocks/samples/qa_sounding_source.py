# SPDX-License-Identifier: GPL-3.0-or-later
"""sounding_source: what a reader transmits, sample by sample."""

import numpy as np
import pytest
from gnuradio import blocks, gr, wiforce


def take(source, count, item_size):
    flowgraph = gr.top_block()
    head = blocks.head(item_size, count)
    sink = blocks.vector_sink_c() if item_size == 8 else blocks.vector_sink_s(2)
    flowgraph.connect(source, head, sink)
    flowgraph.run()
    return np.array(sink.data())


def reference_symbol():
    n = np.arange(64)
    ks = [k for k in range(-31, 32) if k]
    tones = [np.exp(1j * np.pi * k * k / 64 + 2j * np.pi * k * n / 64) for k in ks]
    return np.sum(tones, axis=0) / np.sqrt(62)


@pytest.mark.parametrize("frame_length", [320, 720, 1001])
def test_frame_is_five_symbols_and_zeros_again_and_again(frame_length):
    source = wiforce.sounding_source(frame_length=frame_length, amplitude=0.25)
    samples = take(source, 3 * frame_length + 17, 8)
    frame = np.r_[np.tile(reference_symbol(), 5), np.zeros(frame_length - 320)] * 0.25
    np.testing.assert_allclose(samples, np.tile(frame, 4)[: len(samples)], atol=1e-7)


def test_sc16_samples_are_the_same_at_full_scale_32767():
    pairs = take(wiforce.sounding_source(item_type="sc16", amplitude=0.5), 1440, 4)
    floats = take(wiforce.sounding_source(amplitude=0.5), 1440, 8)
    np.testing.assert_allclose(pairs, floats.view(float) * 32767, atol=0.51)


def test_wifi_preamble_ends_in_two_equal_long_symbols():
    samples = take(wiforce.sounding_source("wifi"), 720, 8)
    np.testing.assert_allclose(samples[192:256], samples[256:320], atol=1e-7)
    np.testing.assert_allclose(samples[160:192], samples[224:256], atol=1e-7)
    assert not samples[320:].any() and samples[:160].any()


def test_amplitude_can_change_and_never_beyond_full_scale():
    source = wiforce.sounding_source()
    source.set_amplitude(0.1)
    power = np.mean(np.abs(take(source, 320, 8)) ** 2)
    assert power == pytest.approx(0.01, rel=1e-5)
    with pytest.raises(ValueError, match="amplitude: must be above 0 and at most"):
        source.set_amplitude(1.1)


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"waveform": "chirps"}, "or 'zadoff-chu' or a .npy file, got 'chirps'"),
        ({"frame_length": 319}, "frame_length: must be an integer >= 320"),
        ({"sample_rate": 0}, "sample_rate_hz: must be positive, got 0"),
        ({"amplitude": 0}, "amplitude: must be above 0 and at most"),
        ({"amplitude": float("nan")}, "amplitude: must be above 0 and at most"),
        ({"item_type": "sc8"}, "item_type: must be one of fc32, sc16, got 'sc8'"),
    ],
)
def test_bad_parameters_are_refused_by_name_rule_and_value(parameters, message):
    with pytest.raises(ValueError) as error:
        wiforce.sounding_source(**parameters)
    assert message in str(error.value)
