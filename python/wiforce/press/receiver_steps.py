# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver's phase and gain, as the static path shows them."""

from __future__ import annotations

import math

import numpy as np

from ..estimation.group_tones import power_of
from ..estimation.groups import Array, Groups

# Time over which the static path's own movement is averaged, in s, and how much a single group
# adds to it: a step must not hide the next one.
_MEMORY_S, _MOST = 1.0, 9.0
# Variance of the static path of a converter, of 2 mdeg: of the receiver, no less.
_LEAST = 1e-9
# Part of the time for which an end is switched on: so much of it is in the mean of a group.
_DUTY = 0.25


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
        self._last: tuple[Array, Array] | None = None
        self._variance = math.nan  # of a turn and a gain

    def process(self, groups: Groups) -> Array:
        """Changes since the group before.

        Parameters
        ----------
        groups : Groups
            With ``ratios`` and ``reference_power``; with ``static``, where it is known.

        Returns
        -------
        ndarray, shape (G, 3)
            Turn in rad, gain in Np, and the variance of each while the receiver does not step.
        """
        changes = np.tile([0.0, 0.0, _LEAST], (len(groups), 1))
        if groups.static is None:
            return changes
        seen = np.repeat(groups.locked, 2, axis=1)
        ratios = np.where(seen, groups.ratios, np.nan)
        first = (groups.static[:1], ratios[:1]) if self._last is None else self._last
        static, ratios = (
            np.concatenate(each) for each in zip(first, (groups.static, ratios), strict=True)
        )
        # The newest group before each that was received.
        power = power_of(static).sum(axis=1)
        there = power != 0
        before = np.maximum.accumulate(np.where(there, np.arange(len(static)), 0))
        self._last = static[before[-1:]], ratios[before[-1:]]
        before = before[:-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.einsum("gk,gk->g", static[1:], static[before].conj()) / power[before]
            steps = np.log(factor)
            # Presses change the tag's own part of the static path; unseen, to the opposite.
            changed = power_of(ratios[1:] - ratios[before])
            changed = np.where(np.isfinite(changed), changed, 4.0) * groups.reference_power
            tag = _DUTY**2 * changed.sum(axis=1) * static.shape[1]
            # A path of another shape, as with another timing, says nothing of a common factor.
            noise = (power[1:] + tag) / power[before] - power_of(factor)
        for row, (turn, gain, own) in enumerate(
            zip(steps.imag.tolist(), steps.real.tolist(), noise.tolist(), strict=True)
        ):
            if not math.isfinite(turn + gain + own):
                continue
            # What the group itself explains says nothing of the groups that follow.
            square = max((turn**2 + gain**2) / 2 - own, 0.0)
            if math.isnan(self._variance):
                self._variance = max(own, _LEAST)
            changes[row] = turn, gain, max(self._variance, own, _LEAST)
            limit = _MOST * max(self._variance, _LEAST)
            self._variance += self._share * (min(square, limit) - self._variance)
        return changes
