# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel estimator, and the blocks with symbols of any length, against NumPy."""

import numpy as np
import pytest
from gnuradio import blocks, wiforce
from gnuradio.wiforce.estimation.capture.frame import MARGIN
from plain import normal
from press_capture import Run, array_source

GROUPS, SNAPSHOTS = 3, 40
estimator = wiforce.ofdm_channel_estimator


@pytest.fixture(params=[17, 48, 64, 600])
def waveform(request):
    length = request.param
    return wiforce.sounding_waveform(
        "chirp", 4 * length + 13, 1e6, symbol_length=length, repetitions=4, averaged_repetitions=3
    )


@pytest.fixture
def samples(waveform):
    rng = np.random.default_rng(4)
    count = GROUPS * SNAPSHOTS * waveform.frame_length
    noise = rng.standard_normal((count, 2), np.float32) @ np.array([0.1, 0.1j], np.complex64)
    return np.tile(waveform.frame(), GROUPS * SNAPSHOTS).astype(np.complex64) + noise


def folded(samples, waveform):
    frames = samples.astype(complex).reshape(-1, waveform.frame_length)
    used = frames[:, waveform.first_averaged :][:, : 3 * waveform.symbol_length]
    return used.reshape(len(frames), 3, -1).mean(axis=1)


def test_fold_and_channel_of_any_symbol_equal_numpy(waveform, samples):
    fold = wiforce.preamble_fold(**waveform.folding, sample_rate=1e6)
    channel = Run(array_source(samples), fold, estimator(waveform.equalizer())).items
    expected = np.fft.fft(folded(samples, waveform), axis=1) * waveform.equalizer()
    np.testing.assert_allclose(channel, expected, atol=2e-5)
    assert np.abs(channel[:, waveform.bins].mean() - 1) < 0.01


@pytest.mark.parametrize("in_one", [True, False])
def test_tones_of_any_symbol_equal_numpy(waveform, samples, in_one):
    rng = np.random.default_rng(6)
    weights = rng.standard_normal((5, SNAPSHOTS)) + 1j * rng.standard_normal((5, SNAPSHOTS))
    weights = weights.astype(np.complex64)
    if in_one:
        chain = [wiforce.preamble_fold.tones(weights, SNAPSHOTS, **waveform.folding)]
    else:
        doppler = wiforce.phase_group_doppler(weights, SNAPSHOTS, waveform.symbol_length)
        chain = [wiforce.preamble_fold(**waveform.folding), doppler]
    tones = Run(array_source(samples), *chain).items.reshape(GROUPS, 5, -1)
    groups = folded(samples, waveform).reshape(GROUPS, SNAPSHOTS, -1)
    expected = np.einsum("mn,gnk->gmk", weights.astype(complex), groups)
    np.testing.assert_allclose(tones, expected, atol=2e-4)


def test_blocks_take_the_sounding_of_a_scene_with_a_symbol_beside_it(tmp_path):
    """Symbol, repetitions and frame length had to be stated again in every block."""
    n = np.arange(48)
    np.save(tmp_path / "own.npy", np.exp(1j * np.pi * n**2 / 48))
    path = tmp_path / "scene.yaml"
    path.write_text(
        "sounding: {waveform: own.npy, repetitions: 3, frame_length: 157}\n"
        "radio: {sample_rate_hz: 1.0e+6}\n"
        "sensors: [{name: arm, model: line-900mhz, clock_hz: 400}]\n"
    )
    scene = wiforce.load_scene(path)
    frame = scene.waveform().frame()
    assert len(frame) == 157
    for given in (scene, str(path)):
        tag = wiforce.backscatter_tag(
            waveform=given, sample_rate=1e6, clock_hz=400, snr_db=60, static_clutter_db=60
        )
        alignment = wiforce.frame_alignment(given, search_frames=16)
        skip, head = blocks.skiphead(8, 100), blocks.head(8, 40 * 157)
        sounder = wiforce.sounding_source(given, amplitude=0.5)
        found = Run(sounder, skip, head, tag, alignment).items[:, 0]
        # The block leaves MARGIN samples before the strongest path, for a weaker and earlier one.
        assert alignment.offset == 57 - MARGIN
        np.testing.assert_allclose(found[MARGIN : MARGIN + 157], 0.5 * frame, atol=5e-3)
    assert wiforce.antenna_ratio(scene).input_signature().sizeof_stream_item(0) == 8 * 48


@pytest.mark.parametrize("rows", [1, 32])
def test_every_row_is_rotated_and_transformed_in_natural_order(rows):
    rng = np.random.default_rng(2)
    vectors, rotation = normal(rng, 11, rows, 64), normal(rng, rows, 64)
    factors = normal(rng, 64)
    source = array_source(vectors.reshape(11, -1).astype(np.complex64))
    channel = Run(source, estimator(factors, rows, rotation)).items.reshape(vectors.shape)
    want = np.fft.fft(rotation * vectors) * factors
    np.testing.assert_allclose(channel, want, atol=1e-6 * np.abs(want).max())
