# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that separates one group after the other."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.likelihood import PhaseLikelihood, evaluate, turned_by
from gnuradio.wiforce.estimation.groups import GroupWeights
from gnuradio.wiforce.signal.switching import switch_averages
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.wiforce_kernels import (
    clock_tracker,
    end_separation,
    locked_tag,
    noise_estimate,
    spread_lines,
    whiten,
)
from plain import normal

CLOCKS_HZ, SNAPSHOTS, T, TA = (1000.0, 1790.0), 625, 57.6e-6, 20.48e-6
SUBCARRIERS, GROUPS, NOISE = 20, 14, 0.01
RATES = 2 * np.pi * np.array(CLOCKS_HZ)
PHASES, PPM, PULSES = (0.4, 2.0), (3.0, -5.0), [(0.1, 0.25, 0.24), (0.0, 0.25, 0.25)]
PLACES, TAGS = (0, 2), 3  # of the locked tags, among all
NARROW = 7  # the subcarrier of another transmitter in a group


def at(likelihood, phase, tones):
    """J, J' and J'' at a phase, of tones (M, K)."""
    covariance = likelihood.covariance(tones[likelihood.rows], np.full(SUBCARRIERS, NOISE))
    return evaluate(turned_by(likelihood.coefficients(covariance), phase))


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
            if group == 11:
                received[:, NARROW] += np.sqrt(20 * NOISE) * normal(rng, SNAPSHOTS)
            if group == 12:
                received += np.sqrt(NOISE) * normal(rng, SNAPSHOTS, SUBCARRIERS)
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
            center = phase + RATES[tag] * self.center_s[0]
            energy, _, curvature = at(likelihood, center, self.tones[0])
            clock = clock_tracker()
            clock.phase, clock.rate = phase, RATES[tag] * 1e-6 * PPM[tag]
            clock.variances, clock.nominal_rate = (1e-5, 0.0, 1e-4), RATES[tag]
            clock.subcarriers = SUBCARRIERS
            clock.slope_variance = SUBCARRIERS * likelihood.noise_variance
            clock.energy, clock.curvature, clock.groups = NOISE * energy, NOISE * curvature, 12
            found.append(clock)
        return found

    @staticmethod
    def noise():
        noise = noise_estimate(SNAPSHOTS * T)
        noise.set(np.full(SUBCARRIERS, NOISE), 1.0, 12)
        return noise


@pytest.fixture(scope="module")
def run():
    return Run()


def locked(run, tracker, i=0, place=0, rows=None, nominal=1.0):
    """One of both tags, on a clock that is off by 1 - ``nominal``, as the kernel takes it."""
    likelihood, (delay, *duty) = run.likelihoods[i], PULSES[i]
    rows, overlapping = likelihood.rows if rows is None else rows, nominal != 1
    rates = RATES[i], nominal * RATES[i]
    return locked_tag(place, tracker, likelihood.kernel, rows, *rates, delay, duty, overlapping)


def kernel_of(tags=1, jointly=False, least_error=0.0, absent_s=0.5):
    return end_separation(tags, SNAPSHOTS, TA, jointly, 0.2, least_error, absent_s, 20.0)


def by_kernel(run, jointly, update, sizes, spread=None, wander=None, least_error=0.01):
    """What the kernel gives of the groups, in batches of some sizes."""
    kernel = kernel_of(TAGS, jointly, least_error)
    noise, trackers, parts, first = run.noise(), run.trackers(), [], 0
    for size in sizes:
        rows = slice(first, first + size)
        tags = [
            locked(run, tracker, i, place, nominal=1.001)
            for i, (place, tracker) in enumerate(zip(PLACES, trackers, strict=True))
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


def test_kernel_states_noise_and_snr_of_each_group(run):
    """Standard deviations and weights of all later stages follow from these."""
    found = by_kernel(run, False, True, [GROUPS], least_error=0.0)
    noise, rise, gain, ends = (found[name] for name in ("noise", "noise_rise", "gain", "ends"))
    # A group that lacks snapshots is no measure of the noise.
    np.testing.assert_array_equal(noise[5], noise[4])
    assert rise[11, NARROW] == pytest.approx(21, rel=0.3) and (rise[11] > 1).sum() == 1
    np.testing.assert_allclose(noise[11, NARROW], noise[10, NARROW] * rise[11, NARROW])
    np.testing.assert_allclose(found["raised"], 1 - np.mean(1 / rise, axis=1))
    # Twice the noise counts, its random errors do not.
    np.testing.assert_allclose(gain[12, [0, 1]], 2 * gain[9, [0, 1]], rtol=0.15)
    np.testing.assert_allclose(gain[1:4, [0, 1]], np.tile(gain[9, [0, 1]], (3, 1)), rtol=5e-3)
    own, level = np.mean(np.abs(ends[9, :2]) ** 2, axis=1), noise[9].mean()
    snr = 0.2 * (own - gain[9, :2] * level) / level
    np.testing.assert_allclose(found["snr_db"][9, :2], 10 * np.log10(snr), atol=1e-6)
    np.testing.assert_array_equal(found["clock2_delay"][9], [0.1, 0, 0])
    # Half of the variance of an end lies along its phase.
    energy = np.sum(np.abs(ends[9, :2]) ** 2 / noise[9], axis=1)
    more = by_kernel(run, False, True, [GROUPS], least_error=0.01)["gain"][9, :2] - gain[9, :2]
    np.testing.assert_allclose(more / energy / 2, 0.01**2, rtol=0.02)


def test_kernel_expects_less_of_a_group_that_lacks_snapshots(run):
    """Its noise is higher: compared with that of whole groups it looks like the tag."""
    likelihood, tracker, lacking = run.likelihoods[0], run.trackers()[0], slice(5, 6)
    tags = [locked(run, tracker)]
    center_s, tones, before = run.center_s[lacking], run.tones[lacking], tracker.energy
    energy, *_ = at(likelihood, tracker.predict(center_s[0]), tones[0])
    arrays = run.weights[lacking], center_s, [False], tones
    kernel_of().process(tags, *arrays, run.noise(), True)
    step = (NOISE * energy * 9 / 10 - before) / tracker.groups
    assert tracker.groups == 13 and tracker.energy == pytest.approx(before + step)


def test_kernel_takes_wander_from_the_residual_only(run):
    """The ends' phases are not disturbed by it."""

    def wander(row, fit, phase, rate):
        assert phase.shape == rate.shape == (2,) and fit.ends.shape == (1, 4, SUBCARRIERS)
        fit.residual[0] *= 1.5

    plain, noisy = (by_kernel(run, False, True, [3], wander=each) for each in (None, wander))
    np.testing.assert_allclose(noisy["ends"][0], plain["ends"][0], rtol=1e-12)
    assert noisy["noise"][-1].mean() > 1.1 * plain["noise"][-1].mean()


def test_kernel_refuses_spread_lines_of_other_tones(run):
    """A kernel must not read beyond its arrays."""
    spread = spread_lines(np.arange(5), np.ones(8), np.ones(5), 4, None, 1)
    with pytest.raises(ValueError, match="spread must be of these tones"):
        by_kernel(run, False, True, [GROUPS], spread)


def test_kernel_stops_before_a_clock_that_is_given_up(run):
    """The tag must be searched again; the groups that follow are separated without it."""
    tags = [locked(run, run.trackers()[0])]
    snapshots = normal(np.random.default_rng(1), GROUPS, SNAPSHOTS, SUBCARRIERS)
    silent = np.sqrt(NOISE) * (run.table.weights @ snapshots)
    weights, complete = run.weights[:1] * GROUPS, np.ones(GROUPS, bool)
    arrays = weights, run.center_s, complete, silent
    found = kernel_of(absent_s=0.05).process(tags, *arrays, run.noise(), True)
    assert 0 < len(found["gain"]) < GROUPS and not found["locked"].any()


def test_kernel_refuses_arrays_of_other_shapes(run):
    """A kernel must not read beyond its arrays."""
    kernel, tracker = kernel_of(TAGS), run.trackers()[0]
    arrays = [run.center_s, run.complete, run.tones]
    for wrong in range(3):
        given = [each[:-1] if i == wrong else each for i, each in enumerate(arrays)]
        with pytest.raises(ValueError, match="must have shape"):
            kernel.process([], run.weights, *given, run.noise(), True)
    for place, rows in ((3, None), (0, run.likelihoods[0].rows + 100)):
        tag = locked(run, tracker, place=place, rows=rows)
        with pytest.raises(ValueError, match="must be"):
            kernel.process([tag], run.weights, *arrays, run.noise(), True)
    with pytest.raises(ValueError, match="those of the likelihood"):
        locked(run, tracker, rows=[1])


def test_tones_in_single_precision_are_those_in_double(run):
    """Streams and recordings give single precision, channel snapshots double."""
    tags = [locked(run, run.trackers()[0])]
    single, arrays = run.tones.astype(np.complex64), (run.weights, run.center_s, run.complete)
    found, expected = (
        kernel_of().process(tags, *arrays, tones, run.noise(), False)["ends"]
        for tones in (single, single.astype(complex))
    )
    assert np.abs(expected).max() > 0.1
    np.testing.assert_array_equal(found, expected)
