# SPDX-License-Identifier: GPL-3.0-or-later
"""One phase group's tones, and the weights that made them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..signal.weights import PartialWeights, ToneTable
from .groups import Array

# A group this much louder than most is left out of an acquisition. A press changes a tag's energy
# by a factor of 6 at most.
_LOUD = 10.0


class GroupWeights:
    """How a group's snapshots became its tones.

    Parameters
    ----------
    weights : ToneTable or PartialWeights
        Of a complete group, or of the snapshots that are there.
    line_gain : ndarray, shape (M, 1)
        By what derotation raises each line (``ToneTable.symbol_gain``).
    times_s : ndarray, shape (n,)
        Times of the snapshots from the group's centre.
    loss : float
        N over the snapshots that are there.
    """

    def __init__(
        self,
        weights: ToneTable | PartialWeights,
        line_gain: Array,
        times_s: Array,
        loss: float = 1.0,
    ) -> None:
        self.whitener = weights.whitener
        self.times_s = times_s
        self.loss = loss
        mixer = line_gain * weights.weights
        # Waveforms are real: two real products are half of a complex one.
        self._mixer = np.vstack([mixer.real, mixer.imag])

    def mix(self, waveforms: Sequence[Array]) -> Array:
        """Tones (M, 2 tags) of waveforms (n, 2) of each tag."""
        mixed = self._mixer @ (waveforms[0] if len(waveforms) == 1 else np.hstack(waveforms))
        half = len(mixed) // 2
        return mixed[:half] + 1j * mixed[half:]


@dataclass(slots=True)
class GroupTones:
    """One group as it came: tones (M, K), the same whitened, and the weights behind them."""

    group: int
    center_s: float
    tones: Array
    white: Array
    weights: GroupWeights
    missing: int
    usable: bool

    def level(self) -> float:
        """Mean of ``power`` over the subcarriers."""
        return float(np.vdot(self.white, self.white).real / self.white.size)

    def power(self) -> Array:
        """Mean power per tone and subcarrier in units of the noise in H; shape (K,)."""
        return power_of(self.white).mean(axis=0)


def without_loud(items: Sequence[GroupTones]) -> list[GroupTones]:
    """The groups without those of some accident, which would drown all the others."""
    if not items:
        return []
    levels = np.array([item.level() for item in items])
    return [items[i] for i in np.flatnonzero(levels <= _LOUD * np.median(levels))]


def power_of(values: Array) -> Array:
    """Squared magnitudes."""
    return values.real**2 + values.imag**2
