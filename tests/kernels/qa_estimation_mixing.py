# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that mixes switching waveforms into tones, against NumPy."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.group_tones import GroupWeights
from gnuradio.wiforce.signal.switching import switch_averages_and_slopes
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.wiforce_kernels import switching_mixer

CLOCKS_HZ, AVERAGING_S = (1000.0, 1790.0), 20.48e-6


def test_switched_tones_are_those_of_the_waveforms_in_numpy():
    """Every reading is computed from these; delays and duty cycles are those of real tags."""
    table = design_weights(CLOCKS_HZ, 625, 57.6e-6)
    gain = np.exp(1j * np.linspace(0, 1, len(table.tones)))[:, None]
    weights = GroupWeights(table, gain, table.times_s)
    rng, groups = np.random.default_rng(1), 20
    phase = rng.uniform(-20, 20, (groups, 2))
    phase[0] = 0, np.pi  # a snapshot in the middle of a pulse
    rate = 2 * np.pi * (np.array(CLOCKS_HZ) * (1 + 1e-4 * rng.standard_normal((groups, 2))))
    half_window = rate * AVERAGING_S / 2
    pulses = [(0.3, 0.25, 0.24), (-0.2, 0.27, 0.25)]
    found = weights.switched(np.stack([phase, rate, half_window], axis=2), pulses)
    expected = []
    for tag, (delay, *duty) in enumerate(pulses):
        phases = phase[:, tag, None] + rate[:, tag, None] * table.times_s
        both = switch_averages_and_slopes(phases, half_window[:, tag], delay, duty)
        expected.append([weights.mix(each) for each in both])
    averages, slopes = (np.concatenate(each, axis=2) for each in zip(*expected, strict=True))
    assert np.abs(averages).max() > 0.01 and np.abs(slopes).max() > 0.01
    np.testing.assert_allclose(found[:, :, :4], averages, atol=1e-12)
    np.testing.assert_allclose(found[:, :, 4:], slopes, atol=1e-12)


@pytest.mark.parametrize(
    "clocks, pulses",
    [((2, 1, 2), (1, 3)), ((2, 1, 3), (2, 3)), ((2, 1, 3), (1, 2)), ((1, 3), (1, 3))],
)
def test_mixer_refuses_arrays_of_other_shapes(clocks, pulses):
    """A kernel must not read beyond its arrays."""
    mixer = switching_mixer(np.ones((4, 5)), np.arange(5.0))
    with pytest.raises(ValueError, match="must have shape"):
        mixer.mix(np.ones(clocks), np.ones(pulses))


@pytest.mark.parametrize("weights", [(4, 6), (5,)])
def test_mixer_refuses_weights_of_other_snapshots(weights):
    """Weights and times must be those of the same snapshots."""
    with pytest.raises(ValueError, match="a column for each of 5"):
        switching_mixer(np.ones(weights), np.arange(5.0))
