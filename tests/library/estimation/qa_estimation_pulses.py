# SPDX-License-Identifier: GPL-3.0-or-later
"""Switches and clocks that are not ideal: widths of the pulses, and jitter inside a group."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.ends.separation import EndSeparator
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.weights import design_weights
from plain import TA, WAVEFORM, T, averaged_switches

LENGTH, GROUPS, TOUCHED = 625, 24, 12
CLOCK_HZ = 1000.0
# Untouched and touched phases of both ends.
BEFORE, AFTER = np.array([20.0, -130.0]), np.array([80.0, -60.0])


class Switched:
    """A tag by counting instants, touched from group 12 on, and what a separator makes of it."""

    def __init__(
        self, seed=1, duty=(0.25, 0.25), delay_s=0.0, jitter_s=0.0, snr_db=10.0, tolerance_ppm=100.0
    ):
        rng = np.random.default_rng(seed)
        t = np.arange(GROUPS * LENGTH) * T
        self.cycles = CLOCK_HZ * (1 + 30e-6) * t + rng.random()
        # The errors of all periods add up.
        walk = np.cumsum(rng.standard_normal(int(t[-1] * CLOCK_HZ) + 2)) * jitter_s * CLOCK_HZ
        self.cycles += np.interp(t, np.arange(len(walk)) / CLOCK_HZ, walk)
        waves = averaged_switches(
            self.cycles, CLOCK_HZ * TA, delay_s * CLOCK_HZ, points=401, duty=duty
        )
        touched = np.arange(len(t)) >= TOUCHED * LENGTH
        ends = np.exp(1j * np.radians(np.where(touched[:, None], AFTER, BEFORE)))
        draw = rng.standard_normal((2, 62, 2)) @ [1, 1j]
        self.channel = 1 + 0.3 * draw[0] / np.sqrt(2)
        self.snapshots = np.outer(np.sum(waves * ends, axis=1), self.channel)
        noise = 0.225 * 10 ** (-snr_db / 20) / np.sqrt(2)
        self.snapshots += noise * rng.standard_normal((len(t), 62, 2)).view(complex)[..., 0]
        self.table = design_weights([CLOCK_HZ], LENGTH, T, 0.0, 12)
        self.stage = EndSeparator(
            self.table, [TagClock(CLOCK_HZ, tolerance_ppm)], WAVEFORM, derotated=False
        )

    def add(self, snapshots):
        self.snapshots += snapshots
        return self

    def separate(self):
        groups = self.snapshots.reshape(GROUPS, LENGTH, 62)
        tones = np.array([self.table.weights @ group for group in groups])
        return self.stage.process(Groups(np.arange(GROUPS), tones))

    @property
    def tag(self):
        """State of the tag in the separator."""
        return self.stage._model.tags[0]


def changes_deg(groups):
    """Error of each end's phase change between both halves of a run, (2,)."""
    ends = groups.ends
    halves = [ends[:TOUCHED].sum(axis=0), ends[TOUCHED:].sum(axis=0)]
    turned = np.degrees(np.angle(np.sum(halves[1] * halves[0].conj(), axis=1)))
    return wrap_deg(turned - (AFTER - BEFORE))


@pytest.mark.parametrize(
    "duty, delay_s",
    [((0.2485, 0.251), 1e-6), ((0.242, 0.259), 3e-6), ((0.26, 0.24), 0.0), ((0.25, 0.255), -2e-6)],
)
def test_pulses_are_found_and_phases_are_as_good_as_with_ideal_ones(duty, delay_s):
    """Comparators of cheap tags miss 25 % duty: end 1 then leaks into line 4, by 0.2 deg."""
    switched = Switched(duty=duty, delay_s=delay_s)
    groups = switched.separate()
    np.testing.assert_allclose(switched.tag.duty, duty, atol=1.5e-4)
    assert switched.tag.clock2_delay == pytest.approx(2 * np.pi * CLOCK_HZ * delay_s, abs=2e-3)
    assert np.abs(changes_deg(groups)).max() < 0.03
    ideal = Switched().separate()
    np.testing.assert_allclose(groups.gain.mean(axis=0), ideal.gain.mean(axis=0), rtol=0.1)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("snr_db", [-10.0, 10.0])
def test_ideal_pulses_stay_ideal(snr_db, seed):
    """Numbers that noise alone suggests would change readings for nothing."""
    switched = Switched(seed, snr_db=snr_db)
    switched.separate()
    assert switched.tag.duty == (0.25, 0.25)


@pytest.mark.parametrize("clock_hz", [1000.02, 2000.05])
def test_pulses_do_not_explain_another_tag(clock_hz):
    """A second tag near our lines also leaves a residual; adapting to it would hide it."""
    switched = Switched()
    rng = np.random.default_rng(7)
    cycles = clock_hz * np.arange(GROUPS * LENGTH) * T + 0.3
    waves = averaged_switches(cycles, clock_hz * TA, points=401)
    course = waves @ np.exp(2j * np.pi * rng.random(2))
    later = np.exp(-2j * np.pi * WAVEFORM.subcarriers * 195e3 * 30e-9)
    groups = switched.add(0.3 * np.outer(course, switched.channel * later)).separate()
    assert switched.tag.duty == (0.25, 0.25)
    assert groups.gain.mean() > 2 * Switched().separate().gain.mean()


def test_jitter_inside_a_group_does_not_raise_the_uncertainty():
    """A resonator's jitter turns lines +m and -m in opposite directions; the phases stay."""
    gains, errors = [], []
    for jitter_s, tolerance_ppm in ((0.0, 300.0), (0.3e-6, 300.0), (0.3e-6, 100.0)):
        groups = Switched(3, jitter_s=jitter_s, tolerance_ppm=tolerance_ppm).separate()
        gains.append((groups.gain * groups.noise.mean()).mean())
        errors.append(np.abs(changes_deg(groups)).max())
    assert gains[1] == pytest.approx(gains[0], rel=0.2)
    assert gains[2] > 3 * gains[0]  # a crystal that jitters is no crystal
    assert errors[1] < 0.04
