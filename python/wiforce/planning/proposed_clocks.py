# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for clocks of further tags beside those that are already on the air."""

from collections.abc import Sequence

import numpy as np

from ..signal.waveform import Waveform
from .clocks import assess_clocks, worst_information
from .mains import farthest_from_lamps, lamp_distances_hz, too_near
from .pulses import Pulses, double_rate_pulses

# Frequencies tried for each tag; each takes about 10 ms.
_CANDIDATES = 60
# Candidates that leave the weakest end this much of the best one's information have about the same
# expected error: 5 % of the variance, 2.5 % of the standard deviation. Among them lamps decide.
_ABOUT_EQUAL = 0.95


def propose_clocks(
    count: int,
    waveform: Waveform,
    group_length: int,
    taken: Sequence[float] = (),
    pulses: tuple[Pulses, Pulses] | None = None,
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
    highest_line: int = 4,
    mains_hz: Sequence[float] = (50.0, 60.0),
) -> list[float]:
    """Clocks for ``count`` more tags beside those ``taken``, chosen one after the other.

    Each leaves the weakest end of all tags nearly the most information that a candidate can. Among
    such candidates, it is the one whose strong lines lie farthest from the lines of lamps.

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
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz; empty in a room without lamps.

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
    candidates = _candidates(lowest, rate / 2 / highest_line, mains_hz)
    settings = waveform, group_length, pulses or double_rate_pulses(), tolerance_ppm, clutter_hz
    clocks = list(taken)
    for _ in range(count):
        best = _best_candidate(candidates, clocks, rate / group_length, settings, mains_hz)
        if best is None or not assess_clocks([*clocks, best], *settings).readable:
            break
        clocks.append(best)
    return clocks[len(taken) :]


def _best_candidate(
    candidates: Sequence[float],
    clocks: Sequence[float],
    resolution_hz: float,
    settings: tuple[Waveform, int, tuple[Pulses, Pulses], float, float],
    mains_hz: Sequence[float],
) -> float | None:
    """The candidate that is best for the weakest end, then against lamps; None without any."""
    free = [c for c in candidates if not any(too_near(c, f, resolution_hz) for f in clocks)]
    if not free:
        return None
    information = [worst_information([*clocks, c], *settings).min() for c in free]
    good = [i for i, q in enumerate(information) if q >= _ABOUT_EQUAL * max(information)]

    def rank(i: int) -> tuple[float, float]:
        return lamp_distances_hz(free[i], mains_hz).min(), information[i]

    return free[max(good, key=rank)]


def _candidates(low: float, high: float, mains_hz: Sequence[float]) -> list[float]:
    """Frequencies from low to below high, in Hz; at most _CANDIDATES.

    Round ones, each exchanged for the nearby one that lies farthest from the lines of lamps.
    """
    if high <= low:
        return []
    step = 10 ** np.ceil(np.log10((high - low) / _CANDIDATES))
    step = next(s for s in (step / 5, step / 2, step) if (high - low) / s <= _CANDIDATES)
    found = []
    for i in range(int(np.ceil(low / step)), int(np.ceil(high / step))):
        edges = max(low, (i - 0.5) * step), min(high, (i + 0.5) * step - 1e-6)
        near = farthest_from_lamps(*edges, mains_hz, i * step) if mains_hz else []
        found.append(near[0] if near and near[0] < high else i * step)
    return list(dict.fromkeys(map(float, found)))
