# SPDX-License-Identifier: GPL-3.0-or-later
"""Where frames begin: a capture that does not start with one must be read all the same."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.capture.frame import (
    MARGIN,
    find_frame_offset,
    find_frame_period,
    keeps_alignment,
    repeats_every_frame,
    samples_needed,
)
from gnuradio.wiforce.signal.waveform import sounding_waveform


def stream(waveform, offset, frames=200, snr_db=-10.0, seed=1):
    rng = np.random.default_rng(seed)
    sent = np.roll(np.tile(waveform.frame(), frames), offset)
    noise = rng.normal(size=(len(sent), 2)).view(complex)[:, 0] * 10 ** (-snr_db / 20) / np.sqrt(2)
    return sent + 0.5 * np.roll(sent, 11) + noise


@pytest.mark.parametrize("name, length", [("repeated", 720), ("wifi", 720), ("repeated", 320)])
@pytest.mark.parametrize("offset", [0, 5, 123, 319])
def test_the_strongest_path_comes_a_margin_after_the_offset(name, length, offset):
    waveform = sounding_waveform(name, length)
    found = find_frame_offset(stream(waveform, offset), waveform)
    # Without a guard the repeated preamble has no other beginning than its symbols'.
    period = 64 if (name, length) == ("repeated", 320) else length
    assert (found + MARGIN) % period == offset % period


def test_noise_alone_is_not_taken_for_a_preamble():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(720 * 500, 2)).view(complex)[:, 0]
    assert find_frame_offset(noise, sounding_waveform()) is None


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_dead_air_and_broken_samples_have_no_offset(value):
    assert find_frame_offset(np.full(7200, value, complex), sounding_waveform()) is None


def test_a_delay_inside_the_dropped_repetition_needs_no_new_alignment():
    waveform = sounding_waveform()
    for late, kept in ((0, True), (20, True), (56, True), (57, False), (700, False)):
        assert keeps_alignment((late - MARGIN) % 720, waveform) is kept


def received(name, length, count, snr_db, offset_hz=0.0):
    """Samples with a few static paths, a carrier offset and noise; SNR of the strongest path."""
    rng = np.random.default_rng(5)
    sent = np.tile(sounding_waveform(name, length).frame(), count // length + 2)
    paths = sent + 0.5j * np.roll(sent, 3) + 0.3 * np.roll(sent, 11) - 0.2 * np.roll(sent, 40)
    noise = rng.normal(size=(count, 2)).view(complex)[:, 0] * 10 ** (-snr_db / 20) / np.sqrt(2)
    turning = np.exp(2j * np.pi * offset_hz / 12.5e6 * np.arange(count))
    return paths[137 : 137 + count] * turning + noise


@pytest.mark.parametrize("name", ["repeated", "wifi"])
@pytest.mark.parametrize(
    "true, snr_db",
    [(320, 0), (320, 30), (321, 30), (384, 0), (660, 0), (720, 0), (720, 30), (20_000, 30)],
)
def test_find_frame_period_names_the_true_length_whatever_is_expected(name, true, snr_db):
    """A wrong frame length gives confident wrong readings; a true one must never be refused."""
    samples = received(name, true, samples_needed(true), snr_db, offset_hz=800)
    own = find_frame_period(samples, sounding_waveform(name, true))
    assert own.agrees and own.samples == true and own.likeness > 0.3
    lengths = {true // 2, 2 * true, 3 * true // 2, true + 1, true - 1, true + 64, 720} - {true}
    # Symbols without a guard repeat after every multiple of 64 samples.
    lengths -= {384} if (name, true) == ("repeated", 320) else set()
    for length in (length for length in lengths if 320 <= length < len(samples) // 4):
        found = find_frame_period(samples, sounding_waveform(name, length))
        assert (found.samples, found.agrees) == (true, False), length


def test_find_frame_period_of_another_rate_is_a_fraction():
    """Whole samples would suggest a frame length that is as wrong."""
    fine = np.fft.fft(received("repeated", 720, 72_000, 30))
    # 1 % more samples of the same band.
    wider = np.insert(fine, len(fine) // 2, np.zeros(720))
    found = find_frame_period(np.fft.ifft(wider), sounding_waveform())
    assert found.samples == pytest.approx(727.2, abs=0.01) and not found.agrees


def test_find_frame_period_without_preambles_finds_none():
    """Tones, DC and bursts of noise repeat as well; read as frames, they gave readings."""
    rng = np.random.default_rng(6)
    count = samples_needed(720)
    noise = 0.01 * rng.normal(size=(count, 2)).view(complex)[:, 0]
    tone = np.exp(0.1j * np.arange(count))
    bursts = 100 * noise * (np.arange(count) % 5000 < 1000)
    for signal in (0, 1, tone, bursts):
        for added in (0, noise):
            found = find_frame_period(signal + added + np.zeros(count), sounding_waveform())
            assert found.samples is None or found.likeness < 0.1


def test_find_frame_period_sees_frames_beside_a_stronger_tone_or_reader():
    """A second reader in the room must not make ours unreadable."""
    count = samples_needed(720)
    ours = received("repeated", 720, count, 30)
    tone = 3 * np.exp(0.233j * np.arange(count))
    other = 3 * received("repeated", 1440, count + 300, 30)[300:]
    assert repeats_every_frame(ours + tone, sounding_waveform())
    assert repeats_every_frame(ours + other, sounding_waveform())
    assert not repeats_every_frame(other, sounding_waveform())
