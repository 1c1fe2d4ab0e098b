# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that separates one group after the other."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.likelihood import PhaseLikelihood
from gnuradio.wiforce.estimation.group_tones import GroupWeights
from gnuradio.wiforce.signal.switching import switch_averages
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.wiforce_kernels import (
    clock_tracker,
    end_separation,
    locked_tag,
    noise_estimate,
    tone_peaks,
    whiten,
)
from plain import normal

CLOCKS_HZ, SNAPSHOTS, T, TA = (1000.0, 1790.0), 625, 57.6e-6, 20.48e-6
SUBCARRIERS, GROUPS, NOISE = 20, 14, 0.01
RATES = 2 * np.pi * np.array(CLOCKS_HZ)
PHASES, PPM, PULSES = (0.4, 2.0), (3.0, -5.0), [(0.1, 0.25, 0.24), (0.0, 0.25, 0.25)]
PLACES, TAGS = (0, 2), 3  # of the locked tags, among all


class Run:
    """Tones of two tags on air, of which the second is absent in one group."""

    def __init__(self):
        rng = np.random.default_rng(7)
        self.table = design_weights(CLOCKS_HZ, SNAPSHOTS, T)
        mask = np.arange(SNAPSHOTS) % 10 > 0
        partial = self.table.for_present(mask)
        gain = np.ones((len(self.table.tones), 1))
        whole = GroupWeights(self.table, gain)
        part = GroupWeights(partial, gain, 10 / 9)
        self.weights = [part if g == 5 else whole for g in range(GROUPS)]
        self.center_s = (np.arange(GROUPS) + 0.5) * SNAPSHOTS * T
        self.sent = ends = normal(rng, 2, 2, SUBCARRIERS)
        self.tones = []
        for group, center_s in enumerate(self.center_s):
            received = np.sqrt(NOISE) * normal(rng, SNAPSHOTS, SUBCARRIERS)
            for tag in range(2 - (group == 8)):
                rate = RATES[tag] * (1 + 1e-6 * PPM[tag])
                phases = PHASES[tag] + rate * (center_s + self.table.times_s)
                waveforms = switch_averages(
                    phases, rate * TA / 2, *PULSES[tag][:1], PULSES[tag][1:]
                )
                received += waveforms @ ends[tag]
            if group == 10:
                received *= 1.5
                received += normal(rng, SNAPSHOTS, 1) * ends[0, 0]
            weights = partial.weights if group == 5 else self.table.weights
            self.tones.append(weights @ (received[mask] if group == 5 else received))
        self.tones = np.array(self.tones)
        both = [
            whiten(weights.whitener, tones[None])
            for weights, tones in zip(self.weights, self.tones, strict=True)
        ]
        self.white, self.level = (np.concatenate(each) for each in zip(*both, strict=True))
        self.complete = np.arange(GROUPS) != 5
        self.likelihoods = [
            PhaseLikelihood(self.table, tag, CLOCKS_HZ[tag] * TA).delayed(delay, tuple(duty))
            for tag, (delay, *duty) in enumerate(PULSES)
        ]

    def trackers(self):
        """Clocks shortly after their acquisition, some mrad and ppm in error."""
        found = []
        for tag, likelihood in enumerate(self.likelihoods):
            phase = PHASES[tag] + 0.004 * (tag + 1)
            own = self.tones[:1, likelihood.rows]
            center = np.array([phase + RATES[tag] * self.center_s[0]])
            energy, _, curvature = likelihood.kernel.at(
                center, own, np.full(SUBCARRIERS, 1 / NOISE)
            )[0]
            found.append(
                clock_tracker(
                    0.0,
                    phase,
                    RATES[tag] * 1e-6 * PPM[tag],
                    (1e-5, 0.0, 1e-4),
                    RATES[tag],
                    SUBCARRIERS,
                    SUBCARRIERS * likelihood.noise_variance,
                    NOISE * energy,
                    NOISE * curvature,
                    12,
                    0.0,
                )
            )
        return found

    @staticmethod
    def noise():
        noise = noise_estimate(SNAPSHOTS * T)
        noise.set(np.full(SUBCARRIERS, NOISE), 1.0, 12)
        return noise


@pytest.fixture(scope="module")
def run():
    return Run()


def by_kernel(run, jointly, update, sizes, spread=None, wander=None):
    """What the kernel gives of the groups, in batches of some sizes."""
    kernel = end_separation(TAGS, SNAPSHOTS, TA, jointly, 0.2, 0.01, 0.5, 20.0)
    noise, trackers, parts, first = run.noise(), run.trackers(), [], 0
    for size in sizes:
        rows = slice(first, first + size)
        tags = [
            locked_tag(
                place, tracker, each.kernel, each.rows, rate, 1.001 * rate, delay, duty, True
            )
            for place, tracker, each, rate, (delay, *duty) in zip(
                PLACES, trackers, run.likelihoods, RATES, PULSES, strict=True
            )
        ]
        found = kernel.process(
            tags,
            run.weights[rows],
            run.center_s[rows],
            run.complete[rows],
            run.tones[rows],
            noise,
            update,
            spread,
            wander,
        )
        assert not found.pop("lost") and len(found["gain"]) == len(run.weights[rows])
        parts.append(found)
        first += size
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@pytest.mark.parametrize("jointly", [False, True])
@pytest.mark.parametrize("update", [True, False])
def test_kernel_separates_alike_in_batches_of_any_size(run, jointly, update):
    """Every reading comes from here, from files and streams."""
    found = by_kernel(run, jointly, update, [GROUPS])
    for sizes in ([1] * GROUPS, [3, 8, 3]):
        for name, values in by_kernel(run, jointly, update, sizes).items():
            np.testing.assert_array_equal(values, found[name], err_msg=name)
    assert np.isinf(found["gain"][:, 2]).all()
    assert found["gain"][10, 0] > 3 * found["gain"][9, 0]
    # Noise of NOISE in 625 snapshots leaves 0.01 in an end that is there for a quarter of the time.
    np.testing.assert_allclose(found["ends"][9, [0, 1, 4, 5]], run.sent.reshape(4, -1), atol=0.06)
    if update:
        assert found["locked"][:, 2].tolist() == [group != 8 for group in range(GROUPS)]
        offset_ppm = (np.array(PPM) - 1000) / 1.001  # of clocks that are 1000 ppm off nominal
        np.testing.assert_allclose(found["clock_offset_ppm"][-1, [0, 2]], offset_ppm, atol=1.5)


def test_kernel_passes_on_what_is_corrected(run):
    """Spread lines are subtracted before the ends are solved, wander from the residual only."""
    plain = by_kernel(run, False, True, [3])
    rows = []

    def spread(row, fit, phase, rate):
        rows.append(row)
        assert phase.shape == rate.shape == (2,) and fit.ends.shape == (1, 4, SUBCARRIERS)
        return 2 * run.white[row]

    def wander(row, fit, phase, rate):
        fit.residual[0] *= 1.5

    louder = by_kernel(run, False, False, [GROUPS], spread)
    assert rows == [*range(GROUPS)]
    unchanged = by_kernel(run, False, False, [GROUPS])
    np.testing.assert_allclose(louder["ends"], 2 * unchanged["ends"], rtol=1e-12)
    noisy = by_kernel(run, False, True, [3], None, wander)
    np.testing.assert_allclose(noisy["ends"][0], plain["ends"][0], rtol=1e-12)
    assert noisy["noise"][-1].mean() > 1.1 * plain["noise"][-1].mean()


def test_kernel_stops_before_a_clock_that_is_given_up(run):
    """The tag must be searched again; the groups that follow are separated without it."""
    kernel = end_separation(1, SNAPSHOTS, TA, False, 0.2, 0.0, 0.05, 20.0)
    likelihood, tracker = run.likelihoods[0], run.trackers()[0]
    tag = locked_tag(
        0,
        tracker,
        likelihood.kernel,
        likelihood.rows,
        RATES[0],
        RATES[0],
        *[0, (0.25, 0.25)],
        False,
    )
    snapshots = normal(np.random.default_rng(1), GROUPS, SNAPSHOTS, SUBCARRIERS)
    silent = np.sqrt(NOISE) * (run.table.weights @ snapshots)
    weights, complete = run.weights[:1] * GROUPS, np.ones(GROUPS, bool)
    found = kernel.process([tag], weights, run.center_s, complete, silent, run.noise(), True)
    assert 0 < len(found["gain"]) < GROUPS and not found["locked"].any()


def test_kernel_refuses_arrays_of_other_shapes(run):
    """A kernel must not read beyond its arrays."""
    kernel = end_separation(TAGS, SNAPSHOTS, TA, False, 0.2, 0.0, 0.5, 20.0)
    arrays = [run.center_s, run.complete, run.tones]
    for wrong in range(3):
        given = [each[:-1] if i == wrong else each for i, each in enumerate(arrays)]
        with pytest.raises(ValueError, match="must have shape"):
            kernel.process([], run.weights, *given, run.noise(), True)
    likelihood, tracker = run.likelihoods[0], run.trackers()[0]
    for place, rows in ((3, likelihood.rows), (0, likelihood.rows + 100)):
        tag = locked_tag(
            place, tracker, likelihood.kernel, rows, 1.0, 1.0, 0.0, (0.25, 0.25), False
        )
        with pytest.raises(ValueError, match="must be"):
            kernel.process([tag], run.weights, *arrays, run.noise(), True)
    with pytest.raises(ValueError, match="those of the likelihood"):
        locked_tag(0, tracker, likelihood.kernel, [1], 1.0, 1.0, 0.0, (0.25, 0.25), False)


def test_tones_in_single_precision_are_those_in_double(run):
    """Streams and recordings give single precision, channel snapshots double."""
    kernel = end_separation(1, SNAPSHOTS, TA, False, 0.2, 0.0, 0.5, 20.0)
    likelihood, tracker = run.likelihoods[0], run.trackers()[0]
    pulses = PULSES[0][0], PULSES[0][1:]
    tag = locked_tag(
        0, tracker, likelihood.kernel, likelihood.rows, RATES[0], RATES[0], *pulses, False
    )
    single, arrays = run.tones.astype(np.complex64), (run.weights, run.center_s, run.complete)
    found, expected = (
        kernel.process([tag], *arrays, tones, run.noise(), False)["ends"]
        for tones in (single, single.astype(complex))
    )
    assert np.abs(expected).max() > 0.1
    np.testing.assert_array_equal(found, expected)


def test_tone_peaks_are_nan_where_a_tone_is_not_finite(run):
    """Groups without tones, or with some that are not finite, are not separated."""
    tones = run.tones.copy()
    tones[0], tones[1, 2, 3], tones[2, 0, 0] = 0, np.nan, 1j * np.inf
    parts = np.maximum(np.abs(tones[3:].real), np.abs(tones[3:].imag))
    found = tone_peaks(tones)
    np.testing.assert_allclose(found[3:], parts.max(axis=(1, 2)), rtol=1e-6)
    assert found[0] == 0 and np.isnan(found[1:3]).all()
