# SPDX-License-Identifier: GPL-3.0-or-later
"""What was once read wrong without a flag, as captures that vary it: docs/press.md, limits."""

import numpy as np
from press_sequences import REFERENCE_S, Sequence, log_uniform, shifted_deg, tag_of

DURATION_S = 12.0
# A press, what is odd or disturbed, and a press.
_PRESSES_S = (1.5, 3.0), (4.5, 8.0), (9.5, 11.0)
_EDGE_S = 0.15  # cables that move while a press begins look like one (docs/press.md)


class Finding(Sequence):
    """A capture in which a finding may show, with the attributes of a Sequence.

    Parameters
    ----------
    kind : str
        Of ``KINDS``.
    seed, snapshots : int
        As for a Sequence.
    """

    def __init__(self, kind, seed, snapshots):
        self.family, self.snapshots = kind, snapshots
        rng = self._rng = np.random.default_rng([seed, snapshots, list(KINDS).index(kind)])
        self.set_time(DURATION_S)
        t, self.receiver = self._t, np.zeros(len(self._t), complex)
        force, location = np.zeros(len(t)), np.full(len(t), 40.0)
        self.spans = [tuple(np.array(span) + rng.uniform(0, 0.4)) for span in _PRESSES_S]
        for begin, end in self.spans:
            rise, here = rng.uniform(0.002, 0.2), (t >= begin) & (t <= end)
            edge = np.minimum((t - begin) / rise, (end - t) / rise)
            force[here] = rng.uniform(2, 7) * np.clip(edge[here], 0, 1)
            location[here] = rng.uniform(38, 42) if rng.random() < 0.5 else rng.uniform(20, 60)
        self.noise_deg = log_uniform(rng, 0.03, 0.2) * np.sqrt(625 / snapshots)
        self.received, self.tares = np.ones(self.groups, bool), []
        odd = (t >= self.spans[1][0]) & (t <= self.spans[1][1])
        location[odd] = rng.uniform(36, 44)
        psi = self.truth.phases_deg(np.maximum(force, 1e-3), location)
        moved = KINDS[kind](self, psi, force, odd)
        psi[force < self.truth.onset_force_n] = self.truth.untouched_deg()
        ratios = np.exp(1j * np.radians(psi - self.truth.untouched_deg() + moved))
        self.receiver = self.receiver.reshape(self._shape)
        self.tags = [tag_of(force, location, ratios, np.ones(len(t), bool), self._shape)]

    def _wide(self, psi, force, odd):
        """The contact is wider than calibrated; up to 12 mm more are those of a harder press."""
        psi[odd] += shifted_deg(self._rng.uniform(12, 40)) / 2
        return 0.0

    def _alike(self, psi, force, odd):
        """A contact that is wider by as much changes both ends alike, as a turn of the tag."""
        psi[odd] = self.truth.phases_deg(np.maximum(force[odd], 1e-3), 40.0)
        psi[odd] += shifted_deg(self._rng.uniform(6, 40)) / 2
        return 0.0

    def _fingers(self, psi, force, odd):
        """Two fingers, or three, of which each end sees the next one."""
        rng = self._rng
        first = rng.uniform(20, 35)
        for end, at in enumerate((first, rng.uniform(first + 20, 60))):
            seen = self.truth.phases_deg(np.maximum(force[odd], 1e-3), at)
            psi[odd, end] = seen[:, end]
        return 0.0

    def _carrier(self, psi, force, odd):
        """The phase of the carrier steps in a press, and when nobody touches."""
        for begin, end in (self.spans[1], (3.5, 4.4)):
            turn = np.radians(self._rng.choice([-1, 1]) * log_uniform(self._rng, 0.5, 180))
            self.receiver += 1j * turn * (self._t > self._rng.uniform(begin, end))
        return 0.0

    def _cables(self, psi, force, odd):
        """A cable of one end moves, or both do, while nobody touches."""
        rng, moved = self._rng, np.zeros((len(self._t), 2))
        untouched = (REFERENCE_S + 0.2, *np.ravel(self.spans), DURATION_S)
        for begin, end in zip(untouched[::2], untouched[1::2], strict=True):
            turn = rng.choice([-1, 1], 2) * rng.uniform(4, 10, 2)
            at = rng.uniform(begin + _EDGE_S, end - _EDGE_S)
            moved += (self._t > at)[:, None] * turn * ([1, 0], [0, 1], [1, 1])[rng.choice(3)]
        return moved

    def _cables_beside(self, psi, force, odd):
        """A cable of one end moves, or both do, during a press."""
        rng, (begin, end) = self._rng, self.spans[1]
        turn = rng.choice([-1, 1], 2) * rng.uniform(4, 10, 2)
        after = self._t > rng.uniform(begin + 2 * _EDGE_S, end - 2 * _EDGE_S)
        return after[:, None] * turn * ([1, 0], [0, 1], [1, 1])[rng.choice(3)]

    def _forced_tare(self, psi, force, odd):
        """A tare is forced while the sensor is pressed."""
        begin, end = self.spans[1]
        self.tares = [(int(self._rng.uniform(begin + 0.3, end - 2.5) / self.period_s), True)]
        return 0.0


#: What may be odd in a capture.
KINDS = {
    "wide contact": Finding._wide,
    "fingers": Finding._fingers,
    "carrier": Finding._carrier,
    "cables": Finding._cables,
    "forced tare": Finding._forced_tare,
    "ends alike": Finding._alike,
    "cables beside a press": Finding._cables_beside,
}
