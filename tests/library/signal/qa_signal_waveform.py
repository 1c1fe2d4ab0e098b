# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounding frame and the tag's switching waveforms against their definitions."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.signal.switching import harmonics, switch_averages
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.simulation.tag import SWITCHES, SwitchingClock, states_at
from plain import TA, averaged_switches


def test_repeated_preamble_is_five_chirps_of_unit_power():
    waveform = sounding_waveform()
    n = np.arange(64)
    symbol = np.zeros(64, complex)
    for k in range(-31, 32):
        if k != 0:
            symbol += np.exp(1j * np.pi * k**2 / 64) * np.exp(2j * np.pi * k * n / 64)
    frame = waveform.frame()
    assert frame.shape == (720,) and not frame[320:].any()
    np.testing.assert_allclose(frame[:320].reshape(5, 64), [symbol / np.sqrt(62)] * 5, atol=1e-12)
    assert np.mean(np.abs(frame[:320]) ** 2) == pytest.approx(1)


@pytest.mark.parametrize(
    "name, first, repetitions, noise, subcarriers",
    [("repeated", 64, 4, 62 / 256, 62), ("wifi", 192, 2, 52 / 128, 52)],
)
def test_waveform_times_and_noise_follow_averaged_samples(
    name, first, repetitions, noise, subcarriers
):
    waveform = sounding_waveform(name)
    assert (waveform.first_averaged, waveform.repetitions) == (first, repetitions)
    assert waveform.channel_noise_gain == noise
    assert len(waveform.subcarriers) == subcarriers
    assert waveform.averaging_s == pytest.approx(repetitions * 64 / 12.5e6)
    assert waveform.snapshot_period_s == pytest.approx(57.6e-6)


@pytest.mark.parametrize("name", ["repeated", "wifi"])
def test_equalizer_folded_frame_gives_channel(name):
    waveform = sounding_waveform(name)
    rng = np.random.default_rng(3)
    # Echoes up to 31 samples late lie inside the part of the preamble that is dropped.
    taps = rng.normal(size=32) + 1j * rng.normal(size=32)
    received = np.convolve(waveform.frame(), taps)
    used = received[waveform.first_averaged :][: 64 * waveform.repetitions]
    folded = used.reshape(-1, 64).mean(axis=0)
    estimate = np.fft.fft(folded) * waveform.equalizer()
    expected = np.zeros(64, complex)
    for k in waveform.subcarriers:
        expected[k % 64] = np.sum(taps * np.exp(-2j * np.pi * k * np.arange(32) / 64))
    np.testing.assert_allclose(estimate, expected, atol=1e-10)


def test_wifi_preamble_has_structure_of_standard():
    preamble = sounding_waveform("wifi").preamble
    np.testing.assert_allclose(preamble[:144], preamble[16:160], atol=1e-12)
    np.testing.assert_allclose(preamble[160:192], preamble[224:256], atol=1e-12)
    np.testing.assert_allclose(preamble[192:256], preamble[256:320], atol=1e-12)
    long = np.fft.fft(preamble[192:256]) / 64 * np.sqrt(52)
    # IEEE 802.11-2020, table 17-8: L(-26), L(-1), L(1), L(26).
    np.testing.assert_allclose(long[[-26, -1, 1, 26]].real, [1, 1, 1, 1], atol=1e-12)
    np.testing.assert_allclose(long[[-24, 2, 25]].real, [-1, -1, 1], atol=1e-12)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("repeated", 319), "frame_length: must be an integer >= 320, the samples of the preamble"),
        (("repeated", 720, 0.0), "sample_rate_hz: must be positive"),
        (("chirps",), "waveform: must be 'repeated' or .* or a .npy file, got 'chirps'"),
    ],
)
def test_sounding_waveform_bad_parameter_names_rule_and_value(arguments, message):
    with pytest.raises(InputError, match=message):
        sounding_waveform(*arguments)


# A count of 4001 instants misplaces each of at most two edges by half an instant.
COUNTING = 1.5 / 4001


@pytest.mark.parametrize("duty", [(0.25, 0.25), (0.24, 0.262)])
@pytest.mark.parametrize("delay", [0.0, 0.031, -0.2])
@pytest.mark.parametrize("width", [0.02048, 0.1])
def test_switch_averages_equal_counted_instants(width, delay, duty):
    cycles = np.random.default_rng(1).uniform(-3, 1e4, 400)
    counted = averaged_switches(cycles, width, delay, duty=duty)
    averages = switch_averages(2 * np.pi * cycles, np.pi * width, 2 * np.pi * delay, duty)
    assert np.max(np.abs(averages - counted)) < COUNTING


@pytest.mark.parametrize("duty", [(0.25, 0.25), (0.242, 0.259)])
@pytest.mark.parametrize("width", [1e-6, 0.02048, 0.1])
def test_harmonics_equal_fourier_coefficients_of_averages(width, duty):
    # The waves are piecewise linear: the mean over 20 000 points errs by some 1e-9.
    cycles = (np.arange(20000) + 0.5) / 20000
    waves = switch_averages(2 * np.pi * cycles, np.pi * width, duty=duty)
    lines = np.arange(-8, 9)
    rotation = np.exp(-2j * np.pi * np.outer(lines, cycles))
    expected = rotation @ waves / len(cycles)
    assert np.max(np.abs(harmonics(lines, width, duty) - expected)) < 2e-5


def test_simulated_switches_equal_counted_instants():
    cycles = np.random.default_rng(2).uniform(-3, 1e4, 400)
    clock = SwitchingClock(1000.0, 0.0, 0.0, 0.0, 0.0)
    made = np.transpose(states_at(clock, SWITCHES["pulses"], 30e-6, cycles / 1000, TA))
    assert np.max(np.abs(made - averaged_switches(cycles, 1000 * TA, 0.03))) < COUNTING
