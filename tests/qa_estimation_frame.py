# SPDX-License-Identifier: GPL-3.0-or-later
"""Where frames begin: a capture that does not start with one must be read all the same."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.frame import MARGIN, find_frame_offset, keeps_alignment
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
