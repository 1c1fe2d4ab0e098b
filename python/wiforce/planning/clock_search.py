# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for clocks of further tags beside those that are already on the air."""

from collections.abc import Sequence

import numpy as np

from ..signal.waveform import Waveform
from .clocks import assess_clocks, worst_information
from .pulses import Pulses, double_rate_pulses

# Frequencies tried for each tag; each takes about 10 ms.
_CANDIDATES = 60


def propose_clocks(
    count: int,
    waveform: Waveform,
    group_length: int,
    taken: Sequence[float] = (),
    pulses: tuple[Pulses, Pulses] | None = None,
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
    highest_line: int = 4,
) -> list[float]:
    """Clocks for ``count`` more tags beside those ``taken``, chosen one after the other.

    Each is the candidate that leaves the weakest end of all tags the most information.

    Parameters
    ----------
    count : int
        Number of tags to add.
    waveform : Waveform
        Gives snapshot period and averaging time.
    group_length : int
        Snapshots per phase group.
    taken : sequence of float
        Clocks in use, in Hz.
    pulses, tolerance_ppm, clutter_hz
        As in :func:`.clocks.assess_clocks`.
    highest_line : int
        Harmonic that must lie below half the snapshot rate.

    Returns
    -------
    list of float
        In Hz; shorter than ``count`` when no more clocks leave every end readable.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> propose_clocks(1, sounding_waveform(), 64, clutter_hz=2000.0)  # no room is left
    []
    """
    rate = 1 / waveform.snapshot_period_s
    lowest = clutter_hz + 10 * rate / group_length
    candidates = _round_numbers(lowest, rate / 2 / highest_line)
    settings = waveform, group_length, pulses or double_rate_pulses(), tolerance_ppm, clutter_hz
    clocks = list(taken)
    for _ in range(count):
        best = _best_candidate(candidates, clocks, rate / group_length, settings)
        if best is None or not assess_clocks([*clocks, best], *settings).readable:
            break
        clocks.append(best)
    return clocks[len(taken) :]


def _best_candidate(
    candidates: Sequence[float],
    clocks: Sequence[float],
    resolution_hz: float,
    settings: tuple[Waveform, int, tuple[Pulses, Pulses], float, float],
) -> float | None:
    """The candidate that leaves the weakest end the most information; None without any."""
    free = [c for c in candidates if not any(_too_near(c, f, resolution_hz) for f in clocks)]
    return max(free, key=lambda c: worst_information([*clocks, c], *settings).min(), default=None)


def _too_near(one: float, other: float, resolution_hz: float) -> bool:
    """Whether main lines fall within four times the resolution of each other."""
    return any(
        abs(a * one - b * other) < 4 * resolution_hz
        for a, b in ((1, 1), (1, 2), (2, 1), (1, 4), (4, 1))
    )


def _round_numbers(low: float, high: float) -> list[float]:
    """Round frequencies from low to below high, in Hz; at most _CANDIDATES."""
    if high <= low:
        return []
    step = 10 ** np.ceil(np.log10((high - low) / _CANDIDATES))
    step = next(s for s in (step / 5, step / 2, step) if (high - low) / s <= _CANDIDATES)
    return [float(f) for f in np.arange(np.ceil(low / step), np.ceil(high / step)) * step]
