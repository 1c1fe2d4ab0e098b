# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a survey in which the scene's own tags do not change.

A press within the survey spreads every line of the tag over its surroundings, where it would pass
for noise of the room, and weights against that noise would remove the tag's own lines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...wiforce_kernels import chi_squared_limit
from ..groups import Array
from .survey import SIGNIFICANT_STDS

# Gauss-Newton steps of the clocks, from those of the survey, which lines that a press has split
# mislead by up to 1 Hz in 0.26 s.
_CLOCK_STEPS = 2
# Times within the survey at which a change may be.
_TIMES = 256


def steady_part(
    channel: Array, period_s: float, clocks_hz: Sequence[float], harmonics: int
) -> slice:
    """The longest part of snapshots (n, K) without a sudden change of the tags' lines.

    Each line is a constant before a change and another one after it; the time of the change is the
    most likely one. Where it is more than noise, the next one is looked for in the longer part.
    """
    begin, end = 0, len(channel)
    while True:
        change = _change(channel[begin:end], period_s, clocks_hz, harmonics)
        if change is None:
            return slice(begin, end)
        if 2 * change >= end - begin:
            end = begin + change
        else:
            begin += change


def _change(
    channel: Array, period_s: float, clocks_hz: Sequence[float], harmonics: int
) -> int | None:
    """First snapshot after the most likely change; None where noise explains it."""
    count, subcarriers = channel.shape
    orders = np.r_[-harmonics:0, 1 : harmonics + 1]
    lines = 1 + len(clocks_hz) * len(orders)  # with the static path
    if count <= max(2 * lines, _TIMES):
        return None
    time_s = (np.arange(count) - (count - 1) / 2) * period_s
    clocks = np.array(clocks_hz, float)
    for step in range(_CLOCK_STEPS + 1):
        waves = np.exp(2j * np.pi * np.outer(time_s, np.outer(clocks, orders)))
        basis = np.column_stack([waves, np.ones(count)])
        sizes = np.linalg.lstsq(basis, channel, rcond=None)[0]
        residual = channel - basis @ sizes
        if step == _CLOCK_STEPS:
            break
        # A clock that is faster rotates lines m and -m in opposite directions, a press alike.
        turned = 2j * np.pi * time_s[:, None] * waves * np.tile(orders, len(clocks))
        for tag in range(len(clocks)):
            own = slice(tag * len(orders), (tag + 1) * len(orders))
            slope = turned[:, own] @ sizes[own]
            clocks[tag] += np.vdot(slope, residual).real / np.vdot(slope, slope).real
    # Sums of the lines' residuals up to each time, all subcarriers at once.
    length = -(-count // _TIMES)
    edges = range(0, count, length)
    parts = [basis[i : i + length].conj().T @ residual[i : i + length] for i in edges]
    sums = np.cumsum(parts, axis=0)[:-1]
    before = np.array(edges[1:])
    gains = np.sum(sums.real**2 + sums.imag**2, axis=(1, 2)) * count / (before * (count - before))
    best = int(np.argmax(gains))
    freedom = lines * subcarriers
    left = float(np.sum(residual.real**2 + residual.imag**2)) - gains[best]
    noise = left / ((count - 2 * lines) * subcarriers)
    if gains[best] <= chi_squared_limit(freedom, SIGNIFICANT_STDS) * freedom * noise:
        return None
    return int(before[best])
