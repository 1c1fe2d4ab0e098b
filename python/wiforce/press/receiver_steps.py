# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver's phase and gain, as the static path shows them."""

from __future__ import annotations

import math

import numpy as np

from ..estimation.groups import Array, Groups

# Time over which the static path's own movement is averaged, in s, and how much a single group
# adds to it: a step must not hide the next one.
_MEMORY_S, _MOST = 1.0, 9.0
# Variance of the static path of a converter, of 2 mdeg: of the receiver, no less.
_LEAST = 1e-9
# An end is switched on for half of the time at most: what a press changes in the mean.
_DUTY = 0.5


class ReceiverSteps:
    """Turn and gain from group to group that all subcarriers of the static path have in common.

    The static path lies tens of dB above the tag. A step of the receiver changes it and the tag
    alike; what somebody changes who walks by differs from subcarrier to subcarrier.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.
    """

    def __init__(self, group_period_s: float) -> None:
        self._share = min(1.0, group_period_s / _MEMORY_S)
        self._last: Array | None = None
        self._variance = math.nan  # of a turn and a gain

    def process(self, groups: Groups) -> Array:
        """Changes since the group before.

        Parameters
        ----------
        groups : Groups
            With ``static``, where it is known, and ``reference_power``.

        Returns
        -------
        ndarray, shape (G, 3)
            Turn in rad, gain in Np, and the variance of each while the receiver does not step.
        """
        changes = np.tile([0.0, 0.0, _LEAST], (len(groups), 1))
        if groups.static is None:
            return changes
        static = groups.static
        first = static[:1] if self._last is None else self._last[None]
        kept = np.concatenate([first, static])
        # The newest group before each that was received.
        there = np.any(kept != 0, axis=1)
        before = kept[np.maximum.accumulate(np.where(there, np.arange(len(kept)), 0))]
        self._last, before = before[-1].copy(), before[:-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            power = np.sum(np.abs(before) ** 2, axis=1)
            factor = np.sum(static * before.conj(), axis=1) / power
            rest = np.sum(np.abs(static - factor[:, None] * before) ** 2, axis=1) / power
            steps = np.log(factor)
            # Presses change the tag's own part of the static path.
            tag = _DUTY**2 * groups.reference_power.sum(axis=1) * static.shape[1] / power
            # A path of another shape, as with another timing, says nothing of a common factor.
            noise = rest + tag
        for row, (turn, gain, own) in enumerate(
            zip(steps.imag.tolist(), steps.real.tolist(), noise.tolist(), strict=True)
        ):
            if not math.isfinite(turn + gain + own):
                continue
            square = (turn**2 + gain**2) / 2
            if math.isnan(self._variance):
                self._variance = max(own, _LEAST)
            changes[row] = turn, gain, max(self._variance, own, _LEAST)
            limit = _MOST * max(self._variance, own, _LEAST)
            self._variance += self._share * (min(square, limit) - self._variance)
        return changes
