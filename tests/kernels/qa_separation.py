# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of the separation, against plain NumPy."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.groups import GroupWeights
from gnuradio.wiforce.signal.switching import switch_averages_and_slopes
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.wiforce_kernels import end_fit, noise_estimate, whiten
from plain import normal

GROUPS, TONES, SUBCARRIERS = 3, 14, 6


@pytest.mark.parametrize("tags", [0, 1, 2, 4])
def test_end_fit_is_the_least_squares_solution(tags):
    """Every reading is computed from these ends, and its noise from this residual."""
    rng = np.random.default_rng(1)
    mixed = rng.standard_normal((GROUPS, TONES, 4 * tags))
    tones = normal(rng, GROUPS, TONES, SUBCARRIERS)
    fit = end_fit(mixed, tones)
    white = mixed[:, :, : 2 * tags]
    solver = np.linalg.pinv(white)
    ends = solver @ tones
    residual = tones - white @ ends
    np.testing.assert_array_equal(fit.white, white)
    np.testing.assert_allclose(fit.solver, solver, atol=1e-12)
    np.testing.assert_allclose(fit.ends, ends, atol=1e-12)
    np.testing.assert_allclose(fit.residual, residual, atol=1e-12)
    np.testing.assert_allclose(fit.gain, np.sum(np.abs(solver) ** 2, axis=2), rtol=1e-10)
    np.testing.assert_allclose(fit.power(), np.sum(np.abs(residual) ** 2, axis=1), rtol=1e-10)
    assert fit.freedom == TONES - 2 * tags
    fit.solve(2j * tones)
    np.testing.assert_allclose(fit.ends, 2j * ends, atol=1e-12)
    np.testing.assert_allclose(fit.residual, 2j * residual, atol=1e-12)


@pytest.mark.parametrize("error", [0.0, 1e-9])
def test_end_fit_of_ends_that_look_the_same_is_the_pseudo_inverse(error):
    """Two tags on one clock: what they have in common is read, and nothing grows without end."""
    rng = np.random.default_rng(2)
    mixed, tones = rng.standard_normal((2, TONES, 8)), normal(rng, 2, TONES, SUBCARRIERS)
    mixed[0, :, 2:4] = mixed[0, :, :2] * (1 + error)
    fit = end_fit(mixed, tones)
    gram = mixed[:, :, :4].swapaxes(1, 2) @ mixed[:, :, :4]
    inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    expected = inverse @ mixed[:, :, :4].swapaxes(1, 2)
    np.testing.assert_allclose(fit.solver, expected, atol=1e-7)
    np.testing.assert_allclose(fit.ends, expected @ tones, atol=1e-7)


def test_noise_with_a_profile_keeps_it_and_is_not_below_rounding_errors():
    """What tags spread over the subcarriers of a long symbol is no noise."""
    profile = np.array([1.0, 2.0, 4.0])
    noise = noise_estimate(0.036, profile)
    assert not noise.known
    noise.set(np.array([3.0, 2.0, 4.0]), 1.0)
    assert noise.known and noise.level == pytest.approx(noise.variance.mean())
    np.testing.assert_allclose(noise.variance, profile * (3 + 1 + 1) / 3, rtol=1e-12)
    np.testing.assert_allclose(noise.inverse, 1 / noise.variance, rtol=1e-12)
    plain = noise_estimate(0.036)
    plain.set(np.zeros(3), 5.0)
    np.testing.assert_allclose(plain.variance, 5e-14, rtol=1e-12)


CLOCKS_HZ, AVERAGING_S = (1000.0, 1790.0), 20.48e-6


def test_switched_tones_are_those_of_the_waveforms_in_numpy():
    """Every reading is computed from these; delays and duty cycles are those of real tags."""
    table = design_weights(CLOCKS_HZ, 625, 57.6e-6)
    gain = 1 - np.abs(np.linspace(-0.5, 0.5, len(table.tones)))[:, None]
    weights = GroupWeights(table, gain)
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


def test_colored_parts_are_the_tones():
    """The lines of a tag are taken from it where others are subtracted."""
    table = design_weights(CLOCKS_HZ, 625, 57.6e-6)
    weights = GroupWeights(table, np.ones((len(table.tones), 1)))
    tones = normal(np.random.default_rng(2), 1, len(table.tones), SUBCARRIERS)
    white, level = whiten(weights.whitener, tones)
    np.testing.assert_allclose(weights.colorer @ white[0], tones[0], atol=1e-12)
    assert level == pytest.approx(np.mean(np.abs(white) ** 2))


@pytest.mark.parametrize("present", [None, np.arange(625) % 9 > 1])
def test_parts_of_white_noise_are_white_and_follow_the_waveforms(present):
    """Least squares weighs every part of the tones alike."""
    table = design_weights(CLOCKS_HZ, 625, 57.6e-6)
    mask = np.ones(625, bool) if present is None else present
    own = table if present is None else table.for_present(mask)
    weights = GroupWeights(own, np.ones((len(table.tones), 1)))
    np.testing.assert_allclose(weights.mixer.T @ weights.mixer, np.eye(len(table.tones)), atol=1e-9)
    waveform = np.random.default_rng(3).standard_normal((mask.sum(), 3))
    white, _ = whiten(own.whitener, (own.weights @ waveform)[None])
    np.testing.assert_allclose(white[0], weights.mix(waveform), atol=1e-7)
