# SPDX-License-Identifier: GPL-3.0-or-later
"""ofdm_channel_estimator against numpy's FFT."""

import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.signal.waveform import sounding_waveform


def estimate(vectors, factors, rows=1, tags=(), **settings):
    width = 64 * rows
    source = blocks.vector_source_c(vectors.ravel().tolist(), False, width, list(tags))
    estimator = wiforce.ofdm_channel_estimator(factors=factors, rows=rows, **settings)
    sink = blocks.vector_sink_c(width)
    flowgraph = gr.top_block()
    flowgraph.connect(source, estimator, sink)
    flowgraph.run()
    return np.array(sink.data()).reshape(-1, rows, 64), sink.tags()


@pytest.mark.parametrize("name", ["repeated", "wifi"])
def test_a_known_channel_is_found_on_its_subcarriers(name):
    waveform = sounding_waveform(name)
    rng = np.random.default_rng(1)
    taps = rng.normal(size=5) + 1j * rng.normal(size=5)
    received = np.convolve(waveform.frame(), taps)
    first, count = waveform.first_averaged, waveform.repetitions
    folded = received[first : first + 64 * count].reshape(count, 64).mean(0)
    channel, _ = estimate(folded[None], waveform.equalizer())
    want = np.zeros(64, complex)
    want[waveform.bins] = np.fft.fft(taps, 64)[waveform.bins]
    # float32 FFT of values near 1, divided by 64
    np.testing.assert_allclose(channel[0, 0], want, atol=2e-6)
    assert np.all(channel[0, 0][want == 0] == 0)


@pytest.mark.parametrize("rows", [1, 3, 32])
def test_every_row_is_transformed_in_natural_order(rows):
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(11, rows, 64)) + 1j * rng.normal(size=(11, rows, 64))
    factors = rng.normal(size=64) + 1j * rng.normal(size=64)
    channel, _ = estimate(vectors, factors, rows)
    want = np.fft.fft(vectors) * factors
    np.testing.assert_allclose(channel, want, atol=1e-6 * np.abs(want).max())


def test_a_tone_that_turns_within_the_symbol_does_not_leak_into_its_neighbours():
    waveform = sounding_waveform()
    turns = np.array([-7000.0, 4000.0]) / waveform.sample_rate_hz
    symbol = waveform.preamble[64:128]
    turning = symbol * np.exp(2j * np.pi * np.outer(turns, np.arange(64)))
    rotation = np.exp(-2j * np.pi * np.outer(turns, np.arange(64)))
    channel, _ = estimate(turning[None], waveform.equalizer(), 2, rotation=rotation)
    # float32 products of values near 1
    np.testing.assert_allclose(channel[0][:, waveform.bins], 1, atol=1e-5)


def test_tags_stay_with_their_items():
    tag = gr.tag_utils.python_to_tag((3, pmt.intern("group"), pmt.from_uint64(9), pmt.PMT_F))
    _, tags = estimate(np.ones((5, 64)), np.ones(64), tags=[tag])
    assert [(t.offset, str(t.key), pmt.to_uint64(t.value)) for t in tags] == [(3, "group", 9)]


@pytest.mark.parametrize(
    ("factors", "rows", "rotation", "message"),
    [
        (np.ones(15), 1, [], "factors must hold .*, got 15 values"),
        (np.full(64, np.nan), 1, [], "factors must be finite"),
        (np.ones(64), 0, [], "rows must be >= 1, got 0"),
        (np.ones(64), 2, np.ones(64), "rotation must hold 128 values, got 64 values"),
        (np.ones(64), 1, np.full(64, np.inf), "rotation must be finite"),
    ],
)
def test_bad_parameters_are_named(factors, rows, rotation, message):
    with pytest.raises(InputError, match=message):
        wiforce.ofdm_channel_estimator(factors=factors, rows=rows, rotation=rotation)
