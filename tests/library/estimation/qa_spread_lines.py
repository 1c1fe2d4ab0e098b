# SPDX-License-Identifier: GPL-3.0-or-later
"""What a tag spreads over the subcarriers of long symbols, against snapshots sample by sample."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.tracked_tag import ClockPath, TagClock, TrackedTag
from gnuradio.wiforce.estimation.ends.least_squares import SpreadLines, ToneModel
from gnuradio.wiforce.estimation.groups import GroupFit, Groups
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.signal.weights import design_weights

CLOCK_HZ, PHASE = 190.0, 0.7
FINE = 16  # instants per sample


def snapshots(waveform, table, ends):
    """Channels (n, K) of a tag that switches at instants within the samples."""
    length, rate_hz = waveform.symbol_length, waveform.sample_rate_hz
    spectrum = np.fft.fft(waveform.symbol)
    received = np.fft.ifft(ends * spectrum, axis=1)
    instants = (np.arange(waveform.repetitions * length * FINE) + 0.5) / (FINE * rate_hz)
    instants -= waveform.averaging_s / 2
    found = []
    for time_s in table.times_s:
        cycles = PHASE / (2 * np.pi) + CLOCK_HZ * (time_s + instants)
        first = np.abs(cycles - np.round(cycles)) < 1 / 8
        twice = 2 * cycles - 0.5
        second = np.abs(twice - np.round(twice)) < 1 / 8
        open_share = np.stack([first, second]).reshape(2, waveform.repetitions, length, FINE)
        folded = (open_share.mean(axis=(1, 3)) * received).sum(axis=0)
        found.append((np.fft.fft(folded) / spectrum)[waveform.bins])
    return np.array(found)


@pytest.mark.parametrize(("length", "repetitions"), [(512, 2), (255, 5)])
def test_removed_lines_leave_the_mean_over_the_symbol(length, repetitions):
    """Whatever is left of them is taken for noise, and limits what a strong tag is read with."""
    waveform = sounding_waveform(
        "zadoff-chu", length * repetitions, 2.5e6, symbol_length=length, repetitions=repetitions
    )
    table = design_weights([CLOCK_HZ], 60, waveform.snapshot_period_s)
    tag = TrackedTag(table, 0, TagClock(CLOCK_HZ), waveform.averaging_s)
    model = ToneModel(table, [tag], None)
    k = np.fft.fftfreq(length, 1 / length)
    ends = np.exp(-2j * np.pi * k * np.array([[2.0], [2.0]]) / length) * [[1.0], [0.8j]]
    tones = table.weights @ snapshots(waveform, table, ends)
    groups, _ = model.prepare(Groups([0], tones[None]))
    rate, half_window = 2 * np.pi * CLOCK_HZ, np.pi * CLOCK_HZ * waveform.averaging_s
    switched = groups.weights[0].switched([[[PHASE, rate, half_window]]], [[0.0, 0.25, 0.25]])
    white = switched[:, :, :2]
    solver = np.linalg.pinv(white)
    fit = GroupFit(np.arange(2), switched, groups.white)
    clean = SpreadLines(waveform).removed(
        groups, fit, [tag], ClockPath(np.array([[PHASE]]), np.zeros((1, 1)))
    )
    expected = white @ ends[:, waveform.bins]
    before = np.mean(np.abs(groups.white - expected) ** 2)
    after = np.mean(np.abs(clean - expected) ** 2)
    assert before > 1e-3 * np.mean(np.abs(expected) ** 2)
    assert after < 1e-4 * before
    np.testing.assert_allclose(solver @ clean, ends[None][:, :, waveform.bins], atol=3e-3)
