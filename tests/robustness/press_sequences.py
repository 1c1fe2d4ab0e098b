# SPDX-License-Identifier: GPL-3.0-or-later
"""Random presses, group by group, and what a receiver reads of them."""

from collections import Counter
from functools import lru_cache

import numpy as np
from gnuradio import wiforce
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.receiver import Receiver
from plain import WAVEFORM

K = len(WAVEFORM.bins)
POINTS = 24  # of a group, over which its phasors are averaged
GROUPS = 400
# A reading is wrong if it is off by more than each of these, as in tests/soak/judge.py.
_STDS, _FORCE_N, _LOCATION_MM, _ONSET_MARGIN_N = 5.0, 0.3, 1.0, 0.3


@lru_cache
def plan_of(sensors):
    named = [
        {"name": f"s{i}", "model": "line-900mhz", "clock_hz": 1000 + 400 * i}
        for i in range(sensors)
    ]
    return wiforce.plan({"sensors": named})


class _AsSeparated:
    """In place of the separation: groups that have been separated."""

    def process(self, groups):
        return groups

    def flush(self):
        return Groups([])


def _knots(rng, begin, end):
    """Times in groups, forces and locations, linear in between: taps, slides, slow and fast."""
    knots, time = [(0.0, 0.0, 40.0)], begin
    while time < end:
        force_n, location_mm = rng.uniform(1.3, 8), _location(rng)
        rise, fall = (_one_of(rng, 0.01, (0.1, 2), (2, 12), (30, 300)) for _ in range(2))
        hold = _one_of(rng, (0.05, 1), (1, 5), (8, 60), (200, 300))
        knots += [(time, 0.0, location_mm), (time + rise, force_n, location_mm)]
        time += rise + hold
        knots.append((time, force_n, location_mm))
        if rng.random() < 0.3:  # slides, changes its force, or is replaced by another press
            time += rng.choice([0.01, rng.uniform(1, 30)])
            force_n, location_mm = rng.uniform(1.3, 8), _location(rng)
            knots.append((time, force_n, location_mm))
            time += hold
            knots.append((time, force_n, location_mm))
        time += fall
        knots.append((time, 0.0, location_mm))
        time += _one_of(rng, (0.1, 1), (1, 3.5), (4, 40), (80, 200))
    return np.array(knots)


def _location(rng):
    """At mid-line, where both phases change alike, more often than elsewhere."""
    return rng.uniform(38, 42) if rng.random() < 0.4 else rng.uniform(3, 77)


def _one_of(rng, *ranges):
    """A value of one of these ranges, the last of them rarely."""
    chosen = ranges[rng.choice(len(ranges), p=[0.35, 0.3, 0.3, 0.05])]
    return rng.uniform(*chosen) if isinstance(chosen, tuple) else chosen


class Sequence:
    """Presses on one sensor or two, and the readings of them.

    Parameters
    ----------
    seed : int
    tares : bool
        Requests tares at any moment, also forced.
    gaps : bool
        Loses groups, and switches a tag off.

    Attributes
    ----------
    counts : Counter
        Of readings.
    wrong : list of str
        Readings without a flag that are not what they say.
    """

    def __init__(self, seed, tares=False, gaps=False):
        rng = np.random.default_rng([seed, tares, gaps])
        self._rng, self._sensors = rng, 2 if rng.random() < 0.2 else 1
        self._plan = plan_of(self._sensors)
        self._tares = tares
        times = (np.arange(GROUPS * POINTS) + 0.5) / POINTS
        begin = self._plan.reference_groups + rng.uniform(5, 40)
        pressed = [_knots(rng, begin, GROUPS).T for _ in range(self._sensors)]
        self._force = [np.interp(times, k[0], k[1]).reshape(GROUPS, POINTS) for k in pressed]
        self._location = [np.interp(times, k[0], k[2]).reshape(GROUPS, POINTS) for k in pressed]
        self._received, self._on = self._lose(gaps)
        self.counts, self.wrong = Counter(), []
        for reading in self._read():
            self._judge(reading)

    def _lose(self, gaps):
        received, on = np.ones(GROUPS, bool), np.ones((GROUPS, self._sensors), bool)
        first = self._plan.reference_groups + 5
        while gaps and first < GROUPS:
            lost = slice(
                first, first + int(_one_of(self._rng, (1, 5), (5, 28), (28, 60), (60, 99)))
            )
            if self._rng.random() < 0.5:
                received[lost] = False
            else:
                on[lost, self._rng.integers(self._sensors)] = False
            first = lost.stop + int(self._rng.exponential(60))
        return received, on

    def _groups(self):
        """Groups with the channels of the ends, and noise."""
        rng, model, ends = self._rng, self._plan.sensors[0].model, []
        for force, location in zip(self._force, self._location, strict=True):
            psi = model.phases_deg(force.ravel(), location.ravel())
            psi[force.ravel() == 0] = model.untouched_deg()
            ends.append(np.exp(1j * np.radians(psi)).reshape(GROUPS, POINTS, 2).mean(axis=1))
        delays = np.linspace(0.02, 0.06, 2 * self._sensors)
        channel = np.exp(-2j * np.pi * np.outer(delays, WAVEFORM.subcarriers / 5.12))
        # What more noise leaves without a flag: docs/theory.md, section "Limits".
        variance = 2 * K * np.radians(np.exp(rng.uniform(np.log(0.03), np.log(0.2)))) ** 2
        noise = rng.standard_normal((2, GROUPS, *channel.shape)) * np.sqrt(variance / 2)
        return Groups(
            np.arange(GROUPS),
            np.zeros((GROUPS, len(self._plan.table.tones), K)),
            ends=channel * np.concatenate(ends, axis=1)[:, :, None] + noise[0] + 1j * noise[1],
            gain=np.where(np.repeat(self._on, 2, axis=1), 1.0, np.inf),
            noise=np.full((GROUPS, K), variance),
            snr_db=np.full((GROUPS, 2 * self._sensors), 10.0),
            locked=self._on,
            overlapping=np.zeros((GROUPS, self._sensors), bool),
            retuned=np.zeros(GROUPS, bool),
        )

    def _read(self):
        """Readings, in batches of any size."""
        groups, rng = self._groups()[self._received], self._rng
        receiver = Receiver(self._plan)
        receiver.separation = _AsSeparated()
        readings, begin = [], 0
        while begin < len(groups):
            end = begin + int(rng.choice([1, 3, 16, 28, 100]))
            if self._tares and rng.random() < 0.15:
                receiver.tare(force=rng.random() < 0.4)
            readings += receiver.process(groups[begin:end])
            begin = end
        return readings + receiver.finish(GROUPS)

    def _judge(self, reading):
        sensor = int(reading.sensor[1:])
        force, location = self._force[sensor][reading.group], self._location[sensor][reading.group]
        onset = self._plan.sensors[0].model.onset_force_n
        steady = np.ptp(force) == 0 and np.ptp(location) == 0
        self.counts["steady touches"] += steady and force[0] > onset
        self.counts["unflagged steady touches"] += steady and force[0] > onset and not reading.flags
        if reading.flags or reading.touch is None:
            return
        wrong = reading.touch == 1 and force.max() < onset - _ONSET_MARGIN_N
        wrong |= reading.touch == 0 and force.min() > onset + _ONSET_MARGIN_N
        if steady and reading.touch == 1 and reading.force_n is not None:
            off_n = abs(reading.force_n - force[0])
            off_mm = abs(reading.location_mm - location[0])
            wrong |= off_n > max(_STDS * reading.force_std_n, _FORCE_N)
            wrong |= off_mm > max(_STDS * reading.location_std_mm, _LOCATION_MM)
        if wrong:
            self.wrong.append(f"{force.min():.2f} N to {force.max():.2f} N, read as {reading}")
