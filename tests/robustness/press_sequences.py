# SPDX-License-Identifier: GPL-3.0-or-later
"""Random presses in seconds, and what else may happen to a sensor; by the signal model alone."""

from dataclasses import dataclass

import numpy as np
from gnuradio import wiforce
from scipy.signal import lfilter

REFERENCE_S, DURATION_S = 0.5, 14.0
SNAPSHOT_S = 57.6e-6
_POINT_S = 2e-3  # a group is the mean over points so far apart, or over six
_LOCATION_MM = (16.0, 64.0)
_FORCE_N = (1.3, 8.0)
# Off states of the switches over their reflection, where they differ and where both are alike, and
# by how much those that the reader knows may be wrong.
OFF_STATES, OFF_ALIKE, OFF_ERROR = (0.3, -0.3), (0.12 - 0.17j, 0.12 - 0.17j), 0.05
_SOME_ENDS = np.array([[1, 0], [0, 1], [1, 1]])

#: What happens in each family beside presses; new ones at the end, as their place is a seed.
FAMILIES = {
    "plain": (),
    "gaps": ("gaps",),
    "silence": ("silence",),
    "tares": ("tares",),
    "drift": ("drift",),
    "turns": ("turns",),
    "gain": ("gain",),
    "carrier": ("carrier",),
    "hand": ("hand",),
    "mixture": ("gaps", "tares", "drift", "gain", "silence"),
    "turning mixture": ("turns", "tares", "drift"),
    "contacts": ("contacts",),
    "cables": ("cables",),
    "off states": ("turned touches", "off states"),
    "off states in error": ("turned touches", "off states", "in error"),
    "tremor": ("tremor",),
    "brownouts": ("brownouts",),
    "warm": ("warm",),
    "off states alike": ("turned touches", "off states alike"),
    "loss": ("loss",),
    "weaker end": ("weaker end",),
    "slow forces": ("slow forces",),
    "bursts": ("bursts",),
    "drifting weaker end": ("weaker end", "drift"),
}


def off_states(effects):
    """Off states of both switches over their reflection; None where they are zero."""
    if "off states alike" in effects:
        return np.array(OFF_ALIKE)
    return np.array(OFF_STATES, complex) if "off states" in effects else None


def _one_of(rng, *ranges):
    """A value of one of four ranges, the last of them rarely."""
    return rng.uniform(*ranges[rng.choice(4, p=[0.3, 0.35, 0.3, 0.05])])


def log_uniform(rng, low, high):
    """A value of a range, in equal parts per octave."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _location(rng):
    """At mid-line, where both phases change alike, more often than elsewhere."""
    return rng.uniform(38, 42) if rng.random() < 0.4 else rng.uniform(*_LOCATION_MM)


def _moments(rng, per_s, end):
    """Times of events of a rate, from shortly after the reference on."""
    time = REFERENCE_S + 0.2
    while (time := time + rng.exponential(1 / per_s)) < end:
        yield time


def _smooth_step(t, begin, duration):
    x = np.clip((t - begin) / duration, 0, 1)
    return x * x * (3 - 2 * x)


def _presses(rng, end):
    """Knots (time, force, location), linear in between, and when each press begins and ends."""
    knots, spans = [(0.0, 0.0, 40.0)], []
    time = REFERENCE_S + rng.uniform(0.3, 1.5)
    while time < end:
        force, location, begin = log_uniform(rng, *_FORCE_N), _location(rng), time
        rise, fall = (
            _one_of(rng, (0.001, 0.005), (0.005, 0.06), (0.06, 0.4), (1, 3)) for _ in range(2)
        )
        hold = _one_of(rng, (0.05, 0.2), (0.2, 0.6), (0.6, 2.5), (4, 8))
        knots += [(time, 0.0, location), (time + rise, force, location)]
        time += rise + hold
        knots.append((time, force, location))
        if rng.random() < 0.3:  # slides, changes its force, or is replaced by another press
            time += _one_of(rng, (0.001, 0.003), (0.003, 0.03), (0.03, 1), (1, 2))
            kind = rng.random()
            force = log_uniform(rng, *_FORCE_N) if kind < 0.7 else force
            location = _location(rng) if kind > 0.4 else location
            knots.append((time, force, location))
            time += hold
            knots.append((time, force, location))
        time += fall
        knots.append((time, 0.0, location))
        spans.append((begin, time))
        time += _one_of(rng, (0.005, 0.04), (0.04, 0.4), (0.4, 1.5), (2, 5))
    return np.array(knots), spans


def _slow_presses(rng, end):
    """Likewise, of forces that rise or fall for seconds, by 0.05 to 2 N/s, or creep as silicone."""
    knots, spans = [(0.0, 0.0, 40.0)], []
    time = REFERENCE_S + rng.uniform(0.3, 1.5)
    while time < end:
        force, location, begin = log_uniform(rng, *_FORCE_N), _location(rng), time
        knots += [(time, 0.0, location), (time + rng.uniform(0.01, 0.2), force, location)]
        time = knots[-1][0]
        lasts = rng.uniform(1, 5)
        if rng.random() < 0.5:
            to = force + rng.choice([-1, 1]) * log_uniform(rng, 0.05, 2) * lasts
            knots += [(time + lasts, np.clip(to, *_FORCE_N), location)]
        else:
            per_e = rng.uniform(-0.08, 0.08) * force
            later = np.geomspace(0.05, lasts, 30)
            knots += [(time + x, force + per_e * np.log(x / 0.05), location) for x in later]
        time = knots[-1][0] + rng.uniform(0.01, 0.2)
        knots.append((time, 0.0, location))
        spans.append((begin, time))
        time += rng.uniform(0.3, 2)
    return np.array(knots), spans


def shifted_deg(nearer_mm):
    """Phase of an end of which the short is nearer: both ways through the line at 900 MHz."""
    return 2 * 360 * 900e6 / 299792458.0 / 1000 * nearer_mm


@dataclass
class _Tag:
    """One sensor over the points of time (G, P), and the share of each group that its tag is on."""

    force: np.ndarray
    location: np.ndarray
    ratios: np.ndarray  # R of both ends, (G, P, 2)
    on: np.ndarray


def tag_of(force, location, ratios, on, shape):
    """A tag from arrays over all points of time."""
    received = (ratios * on[:, None]).reshape(*shape, 2)
    of_groups = force.reshape(shape), location.reshape(shape), received
    return _Tag(*of_groups, on.reshape(shape).mean(axis=1))


class Sequence:
    """What happens in 14 s to one sensor or two, group by group.

    Parameters
    ----------
    seed : int
    snapshots : int
        Snapshots of a group, N_g.
    family : str
        Of ``FAMILIES``.

    Attributes
    ----------
    groups : int
    period_s : float
        Length of a group.
    tags : list of _Tag
    receiver : ndarray of complex, shape (G, P)
        Logarithm of the receiver's gain, which the static path has as well.
    received : ndarray of bool, shape (G,)
    tares : list of (int, bool)
        Groups before which a tare is asked for, and whether it is forced.
    strengths : ndarray, shape (2,)
        Amplitudes of both untouched ends.
    noise_deg : float
        Standard deviation of arg R of an untouched end of strength 1.
    """

    truth = wiforce.load_sensor("line-900mhz")
    strengths = (1.0, 1.0)

    def __init__(self, seed, snapshots, family):
        self.family, effects = family, FAMILIES[family]
        rng = self._rng = np.random.default_rng([seed, snapshots, list(FAMILIES).index(family)])
        self.snapshots = snapshots
        self.set_time(DURATION_S)
        log_gain = np.zeros(len(self._t), complex)
        if "gain" in effects:
            for at in _moments(rng, 0.2, self._end):
                db = rng.choice([-1, 1]) * rng.uniform(1, 6)
                turn = np.radians(rng.uniform(-30, 30))
                log_gain += (self._t > at) * (db / 20 * np.log(10) + 1j * turn)
        if "carrier" in effects:
            for at in _moments(rng, 0.2, self._end):
                turn = np.radians(rng.choice([-1, 1]) * log_uniform(rng, 0.5, 180))
                log_gain += (self._t > at) * 1j * turn
        self.receiver = log_gain.reshape(self._shape)
        self.drift_deg = log_uniform(rng, 0.03, 1.0) if "drift" in effects else 0.0
        self.tags = [self._tag(effects) for _ in range(2 if seed % 5 == 4 else 1)]
        self.received = np.ones(self.groups, bool)
        if "gaps" in effects:
            for at in _moments(rng, 0.3, self._end):
                last = at + log_uniform(rng, 0.004, 2)
                self.received[int(at / self.period_s) : int(last / self.period_s) + 1] = False
        self.tares = []
        if "tares" in effects:
            tares = _moments(rng, 0.15, self._end)
            self.tares = [(int(at / self.period_s), bool(rng.random() < 0.4)) for at in tares]
        self.noise_deg = log_uniform(rng, 0.03, 0.2) * np.sqrt(625 / snapshots)
        if "weaker end" in effects:
            self.strengths = np.ones(2)
            self.strengths[rng.choice(2)] = log_uniform(rng, 0.15, 0.7)

    def set_time(self, duration_s):
        """Divide the time into groups, and these into points."""
        self.period_s = self.snapshots * SNAPSHOT_S
        self.groups = int(duration_s / self.period_s)
        points = max(6, int(np.ceil(self.period_s / _POINT_S)))
        self._shape = self.groups, points
        self._end = self.groups * self.period_s
        self._t = (np.arange(self.groups * points) + 0.5) * self.period_s / points

    def _tag(self, effects):
        rng, t = self._rng, self._t
        presses = _slow_presses if "slow forces" in effects else _presses
        knots, spans = presses(rng, self._end)
        force, location = (np.interp(t, knots[:, 0], knots[:, i]) for i in (1, 2))
        if "tremor" in effects:
            force *= 1 + self._tremor(spans)
        psi = self.truth.phases_deg(np.maximum(force, 1e-3), location)
        if "contacts" in effects:
            self._spoil(psi, force, spans)
        psi[force < self.truth.onset_force_n] = self.truth.untouched_deg()
        log_ratio = 1j * np.radians(psi - self.truth.untouched_deg())
        off = off_states(effects)
        if off is not None:
            if "in error" in effects:
                off *= 1 + OFF_ERROR * np.exp(2j * np.pi * rng.random(2))
            ends = np.exp(1j * np.radians([*psi, self.truth.untouched_deg()])) - off
            log_ratio = np.log(ends[:-1] / ends[-1])
        if "loss" in effects:  # the harder the contact, the more
            most = log_uniform(rng, 0.01, 0.1) * rng.uniform(0.5, 1, 2)
            log_ratio -= most * (1 - np.exp(-force / rng.uniform(0.5, 4)))[:, None]
        if self.drift_deg:
            step = np.radians(self.drift_deg) * np.sqrt(self.period_s / self._shape[1])
            log_ratio += 1j * np.cumsum(step * rng.standard_normal((len(t), 2)), axis=0)
        if "turns" in effects:
            for at in _moments(rng, 0.3, self._end):
                lasts = rng.uniform(0.002, 0.02) if rng.random() < 0.5 else rng.uniform(0.2, 2)
                turn = 0.05 * rng.standard_normal() + 1j * np.radians(rng.uniform(-40, 40))
                log_ratio += (_smooth_step(t, at, lasts) * turn)[:, None]
        if "turned touches" in effects:
            for at in _moments(rng, 0.5, self._end):
                if np.interp(at, t, force) > 0:
                    lasts = rng.uniform(0.002, 0.02) if rng.random() < 0.5 else rng.uniform(0.2, 2)
                    turn = np.radians(rng.choice([-1, 1]) * rng.uniform(1, 40))
                    turn = 0.05 * rng.standard_normal() + 1j * turn
                    log_ratio += (_smooth_step(t, at, lasts) * turn)[:, None]
        if "cables" in effects:  # of one end or of both; in a press it would be a slide
            for at in _moments(rng, 0.2, self._end):
                if np.interp(at, t, force) > 0:
                    continue
                turn = rng.choice([-1, 1], 2) * rng.uniform(4, 10, 2) * _SOME_ENDS[rng.choice(3)]
                log_ratio += (t > at)[:, None] * 1j * np.radians(turn)
        if "warm" in effects:
            log_ratio += 1j * np.radians(self._warmth_deg(force > 0))
        ratios = np.exp(log_ratio)
        if "hand" in effects:
            ratios *= (1 + self._hand(spans))[:, None]
        if "bursts" in effects:  # that hide the tag, of another phase in each group
            for at in _moments(rng, 1.5, self._end):
                here = (t > at) & (t < at + log_uniform(rng, 0.002, 0.05))
                angles = rng.random((self.groups, 1, 2)).repeat(self._shape[1], axis=1)
                by = log_uniform(rng, 0.2, 2) * np.exp(2j * np.pi * angles.reshape(-1, 2))
                ratios[here] += by[here]
        on = np.ones(len(t), bool)
        if "silence" in effects:
            for at in _moments(rng, 0.15, self._end):
                on &= ~((t > at) & (t < at + log_uniform(rng, 0.05, 3.5)))
        if "brownouts" in effects:  # a supply that does not suffice
            period, share = log_uniform(rng, 0.15, 1.5), rng.uniform(0.3, 0.9)
            on &= (t < REFERENCE_S + 0.5) | ((t / period + rng.random()) % 1 < share)
        return tag_of(force, location, ratios, on, self._shape)

    def _tremor(self, spans):
        """Part by which each force swings, (points,): hands at 8 to 12 Hz, motors faster."""
        rng, t, swing = self._rng, self._t, np.zeros(len(self._t))
        for begin, end in spans:
            here = (t >= begin) & (t <= end)
            turns = log_uniform(rng, 1, 30) * t[here] + rng.random()
            swing[here] = log_uniform(rng, 0.05, 0.45) * np.sin(2 * np.pi * turns)
        return swing

    def _warmth_deg(self, touched):
        """Phases that a warm or cold finger adds, (points, 2), to both ends alike or nearly so."""
        rng, most = self._rng, self._rng.choice([-1, 1]) * self._rng.uniform(1, 6)
        kept = np.exp(-(self._t[1] - self._t[0]) / log_uniform(rng, 2, 10))
        warm = lfilter([1 - kept], [1, -kept], touched)
        return warm[:, None] * most * (1, rng.choice([1, rng.uniform(0.8, 1)]))

    def _spoil(self, psi, force, spans):
        """Let half of the presses be contacts that are too wide, or two fingers.

        Those up to 10 mm wider, or closer together, show the phases of a harder press.
        """
        rng = self._rng
        for begin, end in spans:
            kind = rng.choice(3, p=[0.5, 0.25, 0.25])
            here = (self._t >= begin) & (self._t <= end)
            if kind == 1:
                psi[here] += shifted_deg(rng.uniform(20, 40)) / 2
            if kind == 2:  # each end sees the finger that is next to it
                first = rng.uniform(20, 35)
                second = rng.uniform(first + 20, 60)
                for end_of_line, at in enumerate((first, second)):
                    seen = self.truth.phases_deg(np.maximum(force[here], 1e-3), at)
                    psi[here, end_of_line] = seen[:, end_of_line]

    def _hand(self, spans):
        """The echo of the hand that presses: it comes, stays while it presses, trembling, goes."""
        rng, t, echo = self._rng, self._t, np.zeros(len(self._t), complex)
        for begin, end in spans:
            comes = rng.uniform(0.2, 0.6)
            near = _smooth_step(t, begin - comes, comes) * (1 - _smooth_step(t, end, comes))
            away_mm = 150 * (1 - near) + 3 * np.sin(2 * np.pi * (0.7 * t + rng.random()))
            turn = rng.random() - 2 * away_mm / 333
            echo += rng.uniform(0.02, 0.1) * near * np.exp(2j * np.pi * turn)
        return echo
