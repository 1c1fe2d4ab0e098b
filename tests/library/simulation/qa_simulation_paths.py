# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths, filters and converter of the simulated front end against their definitions."""

import numpy as np
import pytest
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.simulation.paths import MovingPath, delay_taps, response, tag_taps
from gnuradio.wiforce.simulation.radio import Adc
from gnuradio.wiforce.simulation.random_sources import Fir


@pytest.mark.parametrize("delay", [2.0, 2.25, 3.7])
def test_delay_taps_fractional_delay_rotates_subcarriers(delay):
    waveform = sounding_waveform()
    k = waveform.subcarriers
    inner = np.abs(k) < 13
    h = response(delay_taps(delay, 8 if delay > 3 else 4), waveform)
    expected = np.exp(-2j * np.pi * k * delay / 64)
    assert np.abs(h - expected)[inner].max() < 0.06


def test_tag_taps_fading_has_unit_power():
    waveform = sounding_waveform()
    powers = np.array(
        [
            np.abs(response(tag_taps(np.random.default_rng(i), waveform, 2e6), waveform)) ** 2
            for i in range(300)
        ]
    )
    np.testing.assert_allclose(powers.mean(axis=1), 1, rtol=1e-9)
    # Rayleigh: 10 % of an exponential lies below 0.105; less where the band's mean is held at 1.
    assert 0.04 < np.mean(powers < 0.105) < 0.1
    np.testing.assert_allclose(np.abs(response(tag_taps(None, waveform, None), waveform)), 1)


def test_moving_path_stays_within_doppler():
    for seed in range(5):
        path = MovingPath(np.random.default_rng(seed), 200.0, sweeps=seed % 2 == 0)
        t = np.arange(0, 20, 1e-3)
        gain = path.gain(t)
        np.testing.assert_allclose(np.abs(gain), 1)
        spectrum = np.abs(np.fft.fft(gain * np.kaiser(len(t), 20))) ** 2
        outside = np.abs(np.fft.fftfreq(len(t), 1e-3)) > 200
        assert spectrum[outside].sum() < 1e-6 * spectrum.sum()


@pytest.mark.parametrize("kind", [np.float64, np.complex128])
def test_fir_equals_convolution(kind):
    rng = np.random.default_rng(0)
    taps = rng.standard_normal(6).astype(kind)
    if kind is np.complex128:
        taps = taps + 1j * rng.standard_normal(6)
    sent = (rng.standard_normal(300) + 1j * rng.standard_normal(300)).astype(np.complex64)
    out, scratch = np.empty((2, 250), np.complex64)
    Fir(taps).apply(sent, 250, out, scratch)
    np.testing.assert_allclose(out, np.convolve(sent, taps)[50:300], atol=3e-6)


@pytest.mark.parametrize("bits", [2, 8, 14, 16, None])
def test_adc_codes_are_rounded_clipped_and_left_justified(bits):
    used = bits or 16
    step = 2.0 ** -(used - 1)
    values = np.array([0, step, -step, 0.4 * step, 2.0, -2.0, 0.5, -0.5])
    codes = Adc(bits).codes(values[::2] + 1j * values[1::2])
    shift = 2 ** (16 - used)
    full = 2 ** (used - 1)
    expected = [0, 1, -1, 0, full - 1, -full, full // 2, -(full // 2)]
    assert codes.dtype == np.int16
    np.testing.assert_array_equal(codes, np.array(expected) * shift)
