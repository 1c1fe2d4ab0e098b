# SPDX-License-Identifier: GPL-3.0-or-later
"""What tags spread over the subcarriers by switching within a symbol, against single samples."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.ends.least_squares import spread_lines_of
from gnuradio.wiforce.estimation.groups import GroupWeights
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.wiforce_kernels import end_fit, spread_lines, whiten
from plain import averaged_switches, normal

CLOCKS_HZ, SNAPSHOTS = (1035.0, 1790.0), 320
PULSES = [(0.1, 0.25, 0.24), (0.0, 0.25, 0.25)]
PHASES, RATES = (0.4, 2.0), 2 * np.pi * np.array(CLOCKS_HZ) * (1 + 1e-6 * np.array([80, -40]))


def tones_of_samples(waveform, table, of_group, ends):
    """Tones (M, K) of a group, from each sample of what both tags reflect of the symbols."""
    length, repetitions = waveform.symbol_length, waveform.repetitions
    received = ends * waveform.symbol
    count = length * repetitions
    offset_s = (np.arange(count) - (count - 1) / 2) / waveform.sample_rate_hz
    folded = np.zeros((len(of_group.times_s), length), complex)
    for tag, (delay, *duty) in enumerate(PULSES):
        phases = PHASES[tag] + RATES[tag] * (of_group.times_s[:, None] + offset_s).ravel()
        width = RATES[tag] / waveform.sample_rate_hz / (2 * np.pi)
        on = averaged_switches(
            phases / (2 * np.pi), width, delay / (2 * np.pi), points=101, duty=duty
        )
        on = on.reshape(-1, repetitions, length, 2).mean(axis=1)
        folded += on[..., 0] * received[2 * tag] + on[..., 1] * received[2 * tag + 1]
    samples = of_group.weights @ folded
    if waveform.is_derotated:
        samples = samples * table.derotation(waveform.sample_rate_hz, length)
    return (np.fft.fft(samples, axis=1) * waveform.equalizer())[:, waveform.bins]


@pytest.mark.parametrize("frame_length, length", [(720, 64), (330, 64), (720, 128)])
@pytest.mark.parametrize("gap", [0, 40])
def test_ends_explain_tones_of_samples_without_spread_lines(frame_length, length, gap):
    """With a strong tag, the SNR was stated up to 15 dB too low and errors too large."""
    waveform = sounding_waveform("zadoff-chu", frame_length, symbol_length=length)
    table = design_weights(CLOCKS_HZ, SNAPSHOTS, waveform.snapshot_period_s)
    of_group = table.for_present(np.arange(SNAPSHOTS) >= gap) if gap else table
    gain = np.ones((len(table.tones), 1))
    if waveform.is_derotated:
        gain = 1 / table.symbol_gain(waveform.sample_rate_hz, length)[:, None]
    weights, ends = GroupWeights(of_group, gain), normal(np.random.default_rng(3), 4, 1)
    tones = tones_of_samples(waveform, table, of_group, ends)
    white, _ = whiten(weights.whitener, tones[None])
    clocks = np.transpose([PHASES, RATES, RATES * waveform.averaging_s / 2])[None]
    fit = end_fit(weights.switched(clocks, PULSES), white)
    before = np.sum(fit.power())
    spread = spread_lines_of(waveform, table)
    fit.solve(spread.removed(fit, [weights], clocks, PULSES, tones[None]))
    assert np.sum(fit.power()) < 1e-4 * before
    np.testing.assert_allclose(fit.ends[0], ends.repeat(len(waveform.bins), axis=1), atol=3e-4)


def test_spread_lines_refuse_arrays_of_other_shapes():
    """A kernel must not read beyond its arrays."""
    waveform = sounding_waveform()
    table = design_weights(CLOCKS_HZ, SNAPSHOTS, waveform.snapshot_period_s)
    weights = GroupWeights(table, np.ones((len(table.tones), 1)))
    white = normal(np.random.default_rng(1), 1, len(table.tones), len(waveform.bins))
    clocks = np.transpose([PHASES, RATES, RATES * waveform.averaging_s / 2])[None]
    fit, spread = end_fit(weights.switched(clocks, PULSES), white), spread_lines_of(waveform, table)
    arrays = [[weights], clocks, np.array(PULSES), white]
    assert spread.removed(fit, *arrays).shape == white.shape
    for wrong in range(4):
        given = [each[:-1] if i == wrong else each for i, each in enumerate(arrays)]
        with pytest.raises(ValueError, match="spread_lines"):
            spread.removed(fit, *given)
    bins = waveform.bins
    for given in ((bins[:-1], waveform.symbol), (bins, waveform.symbol[:0])):
        with pytest.raises((ValueError, IndexError)):
            spread_lines(*given, np.ones(len(bins)), 4, None, 1)
