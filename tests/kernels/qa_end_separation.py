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
)
from plain import normal

CLOCK_HZ, SNAPSHOTS, T, TA = 1000.0, 625, 57.6e-6, 20.48e-6
SUBCARRIERS, GROUPS, NOISE = 20, 14, 0.01
RATE, PHASE, PPM, PULSES = 2 * np.pi * CLOCK_HZ, 0.4, 3.0, (0.1, 0.25, 0.24)
PLACE, TAGS = 1, 3  # of the locked tag, among all
OWN = [2 * PLACE, 2 * PLACE + 1]  # its ends
NARROW = 7  # the subcarrier of another transmitter in a group


class Run:
    """Tones of a tag, with a group that lacks snapshots and three that are disturbed."""

    def __init__(self):
        rng = np.random.default_rng(8)
        self.table = design_weights([CLOCK_HZ], SNAPSHOTS, T, harmonics=24)
        mask = np.arange(SNAPSHOTS) % 10 > 0
        partial = self.table.for_present(mask)
        gain = np.ones((len(self.table.tones), 1))
        self.weights = [GroupWeights(self.table, gain)] * GROUPS
        self.weights[5] = GroupWeights(partial, gain, 10 / 9)
        self.complete = np.arange(GROUPS) != 5
        self.center_s = (np.arange(GROUPS) + 0.5) * SNAPSHOTS * T
        delay, *duty = PULSES
        rate, ends, tones = RATE * (1 + 1e-6 * PPM), normal(rng, 2, SUBCARRIERS), []
        for group, center_s in enumerate(self.center_s):
            phases = PHASE + rate * (center_s + self.table.times_s)
            received = switch_averages(phases, rate * TA / 2, delay, duty) @ ends
            received += np.sqrt(NOISE) * normal(rng, SNAPSHOTS, SUBCARRIERS)
            if group == 10:
                received *= 1.5
                received += normal(rng, SNAPSHOTS, 1) * ends[0]
            if group == 11:
                received[:, NARROW] += np.sqrt(20 * NOISE) * normal(rng, SNAPSHOTS)
            if group == 12:
                received += np.sqrt(NOISE) * normal(rng, SNAPSHOTS, SUBCARRIERS)
            weights = partial.weights if group == 5 else self.table.weights
            tones.append(weights @ (received[mask] if group == 5 else received))
        self.tones = np.array(tones)
        likelihood = PhaseLikelihood(self.table, 0, CLOCK_HZ * TA)
        self.likelihood = likelihood.delayed(delay, tuple(duty))

    def at(self, phase, tones):
        """J, J' and J'' at a phase, of tones (M, K)."""
        own, noise = tones[self.likelihood.rows], np.full(SUBCARRIERS, NOISE)
        coefficients = self.likelihood.coefficients(self.likelihood.covariance(own, noise))
        return evaluate(turned_by(coefficients, phase))

    def clock(self):
        """The clock shortly after its acquisition, some mrad in error."""
        clock, phase = clock_tracker(), PHASE + 0.004
        energy, _, curvature = self.at(phase + RATE * self.center_s[0], self.tones[0])
        clock.phase, clock.rate, clock.nominal_rate = phase, RATE * 1e-6 * PPM, RATE
        clock.variances, clock.subcarriers = (1e-5, 0.0, 1e-4), SUBCARRIERS
        clock.slope_variance = SUBCARRIERS * self.likelihood.noise_variance
        clock.energy, clock.curvature, clock.groups = NOISE * energy, NOISE * curvature, 12
        return clock

    def locked(self, clock, place=PLACE, rows=None):
        """The tag as the kernel takes it."""
        (delay, *duty), own = PULSES, self.likelihood
        rows = own.rows if rows is None else rows
        return locked_tag(place, clock, own.kernel, rows, RATE, RATE, delay, duty, False)

    def separated(self, clock=None, rows=slice(None), tones=None, spread=None, **settings):
        """What the kernel gives of some groups of the tag, or of other tones."""
        arrays = self.weights[rows], self.center_s[rows], self.complete[rows]
        tones, tag = self.tones if tones is None else tones, self.locked(clock or self.clock())
        return kernel_of(**settings).process([tag], *arrays, tones[rows], known(), True, spread)


def known():
    """The noise after its acquisition."""
    noise = noise_estimate(SNAPSHOTS * T)
    noise.set(np.full(SUBCARRIERS, NOISE), 1.0, 12)
    return noise


def kernel_of(least_error=0.0, absent_s=0.5):
    return end_separation(TAGS, SNAPSHOTS, TA, False, 0.2, least_error, absent_s, 20.0)


@pytest.fixture(scope="module")
def run():
    return Run()


def test_kernel_states_noise_and_snr_of_each_group(run):
    """Standard deviations and weights of all later stages follow from these."""
    found = run.separated()
    noise, rise, ends = (found[name] for name in ("noise", "noise_rise", "ends"))
    gain, others = found["gain"][:, OWN], np.delete(found["gain"], OWN, axis=1)
    assert len(gain) == GROUPS and np.isinf(others).all() and gain[10, 0] > 3 * gain[9, 0]
    # A group that lacks snapshots is no measure of the noise.
    np.testing.assert_array_equal(noise[5], noise[4])
    assert rise[11, NARROW] == pytest.approx(21, rel=0.3) and (rise[11] > 1).sum() == 1
    np.testing.assert_allclose(noise[11, NARROW], noise[10, NARROW] * rise[11, NARROW])
    np.testing.assert_allclose(found["raised"], 1 - np.mean(1 / rise, axis=1))
    # Twice the noise counts, its random errors do not.
    np.testing.assert_allclose(gain[12], 2 * gain[9], rtol=0.15)
    np.testing.assert_allclose(gain[1:4], np.tile(gain[9], (3, 1)), rtol=5e-3)
    power = np.abs(ends[9, OWN]) ** 2
    snr = 0.2 * (power.mean(axis=1) - gain[9] * noise[9].mean()) / noise[9].mean()
    np.testing.assert_allclose(found["snr_db"][9, OWN], 10 * np.log10(snr), atol=1e-6)
    np.testing.assert_array_equal(found["clock2_delay"][9], [0, 0.1, 0])
    # Half of the variance of an end lies along its phase.
    more = run.separated(least_error=0.01)["gain"][9, OWN] - gain[9]
    np.testing.assert_allclose(more / np.sum(power / noise[9], axis=1) / 2, 0.01**2, rtol=0.02)


def test_kernel_expects_less_of_a_group_that_lacks_snapshots(run):
    """Its noise is higher: compared with that of whole groups it looks like the tag."""
    clock = run.clock()
    before, (energy, *_) = clock.energy, run.at(clock.predict(run.center_s[5]), run.tones[5])
    run.separated(clock, slice(5, 6))
    step = (NOISE * energy * 9 / 10 - before) / clock.groups
    assert clock.groups == 13 and clock.energy == pytest.approx(before + step)


def test_kernel_stops_before_a_clock_that_is_given_up(run):
    """The tag must be searched again; the groups that follow are separated without it."""
    snapshots = normal(np.random.default_rng(1), GROUPS, SNAPSHOTS, SUBCARRIERS)
    found = run.separated(tones=np.sqrt(NOISE) * (run.table.weights @ snapshots), absent_s=0.05)
    assert 0 < len(found["gain"]) < GROUPS and not found["locked"].any()


def test_kernel_refuses_arrays_of_other_shapes(run):
    """A kernel must not read beyond its arrays."""
    clock, arrays = run.clock(), [run.center_s, run.complete, run.tones]
    for wrong in range(3):
        given = [each[:-1] if i == wrong else each for i, each in enumerate(arrays)]
        with pytest.raises(ValueError, match="must have shape"):
            kernel_of().process([], run.weights, *given, known(), True)
    for place, rows in ((TAGS, None), (0, run.likelihood.rows + 100)):
        tag = run.locked(clock, place, rows)
        with pytest.raises(ValueError, match="must be"):
            kernel_of().process([tag], run.weights, *arrays, known(), True)
    with pytest.raises(ValueError, match="those of the likelihood"):
        run.locked(clock, rows=[1])
    with pytest.raises(ValueError, match="spread must be of these tones"):
        run.separated(spread=spread_lines(np.arange(5), np.ones(8), np.ones(5), 4, None, 1))
