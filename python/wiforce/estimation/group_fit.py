# SPDX-License-Identifier: GPL-3.0-or-later
"""One group's tones, and their least-squares fit by the tags' waveforms."""

from dataclasses import dataclass

import numpy as np

# A group this much louder than most is left out of an acquisition. A press changes a tag's energy
# by a factor of 6 at most.
_LOUD = 10.0


@dataclass(frozen=True)
class GroupTones:
    """A group as it came, with the weights behind it; ``loss`` is N over snapshots present."""

    group: int
    center_s: float
    tones: np.ndarray
    whitener: np.ndarray
    white: np.ndarray
    mixer: np.ndarray
    times_s: np.ndarray
    missing: int
    loss: float
    usable: bool

    def level(self):
        """Mean of ``power`` over the subcarriers."""
        return np.vdot(self.white, self.white).real / self.white.size

    def power(self):
        """Mean power per tone and subcarrier in units of the noise in H; shape (K,)."""
        return power_of(self.white).mean(axis=0)


@dataclass(frozen=True)
class GroupFit:
    """Tones = mixing @ ends + what is left, for the ends ``rows``.

    ``white`` is the whitened mixing, ``solver`` its pseudo-inverse, ``left`` is whitened too.
    """

    rows: np.ndarray
    mixing: np.ndarray
    ends: np.ndarray
    gain: np.ndarray
    left: np.ndarray = None
    white: np.ndarray = None
    solver: np.ndarray = None


def without_loud(items):
    """Groups without those of some accident, which would drown all the others."""
    if not items:
        return items
    levels = np.array([item.level() for item in items])
    return [items[i] for i in np.flatnonzero(levels <= _LOUD * np.median(levels))]


def power_of(values):
    """Squared magnitudes."""
    return values.real**2 + values.imag**2


def inverse_of(gram):
    """Inverse of a small positive definite matrix, by elimination.

    LAPACK's start-up costs more than all the rest of a group where its threads are not held back.
    """
    size = len(gram)
    work = np.hstack([gram, np.eye(size)])
    smallest = 1e-12 * gram.diagonal().real.max()
    for i in range(size):
        if work[i, i].real <= smallest:
            return np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
        work[i] /= work[i, i]
        factors = work[:, i].copy()
        factors[i] = 0.0
        work -= factors[:, None] * work[i]
    return work[:, size:]
