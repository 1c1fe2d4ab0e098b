# SPDX-License-Identifier: GPL-3.0-or-later
"""Force of a press over time, and what a soft beam that is not elastic shows of it."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...scene.effects import Beam
    from ...scene.simulated import Press

# Physiological tremor of a hand lies between 8 and 12 Hz.
TREMOR_HZ = (8.3, 9.7, 11.4)


def press_force(press: "Press", time_s: np.ndarray) -> np.ndarray:
    """Force of a press at times within it, with the tremor of a hand that holds it.

    Returns ndarray of float, shape (n,): in N.

    Parameters
    ----------
    time_s : ndarray of float, shape (n,)
    """
    force = np.interp(time_s, *_profile(press))
    if press.tremor_n:
        cycles = np.outer(TREMOR_HZ, time_s - press.start_s)
        tremor = np.sin(2 * np.pi * cycles).sum(axis=0) * np.sqrt(2 / len(TREMOR_HZ))
        share = force / max(press.force_n, press.end_force_n)
        force = np.maximum(force + press.tremor_n * share * tremor, 0.0)
    return force


def shown_force(press: "Press", time_s: np.ndarray, beam: "Beam") -> np.ndarray:
    """Force that an elastic beam would need for the same contact.

    Returns ndarray of float, shape (n,): in N.

    Parameters
    ----------
    time_s : ndarray of float, shape (n,)
        Within the press.

    Notes
    -----
    After the largest force P so far, the contact shows F + 4 h F (P - F) / P: it opens later than
    it closed, most at half of P, by h P. Creep adds c times the force, low-pass filtered with the
    stated time constant (a standard linear solid). The filter starts at zero with each press.
    """
    force = press_force(press, time_s)
    times, forces = _profile(press)
    reached = np.where(time_s >= times[1], forces[1], 0.0)
    reached = np.maximum(reached, np.where(time_s >= times[2], forces[2], 0.0))
    peak = np.maximum(np.maximum(force, reached), 1e-9)
    shown = force + 4 * beam.hysteresis * force * (peak - force) / peak
    if beam.creep:
        shown += beam.creep * _low_pass(times, forces, beam.creep_s, time_s)
    return shown


def _profile(press: "Press") -> tuple[np.ndarray, list[float]]:
    """Times and forces between which a press is linear."""
    times = press.start_s + np.cumsum([0, press.rise_s, press.hold_s, press.rise_s])
    return times, [0.0, press.force_n, press.end_force_n, 0.0]


def _low_pass(
    knots: np.ndarray, values: list[float], constant_s: float, time_s: np.ndarray
) -> np.ndarray:
    """A piecewise linear signal through a filter of first order that starts at 0."""
    result, state = np.zeros(time_s.shape), 0.0
    for i in range(len(knots) - 1):
        length = knots[i + 1] - knots[i]
        if length == 0:
            continue
        slope = (values[i + 1] - values[i]) / length
        after = np.append(np.clip(time_s - knots[i], 0, length), length)
        lagging = slope * constant_s
        filtered = values[i] + slope * after - lagging
        filtered += (state - values[i] + lagging) * np.exp(-after / constant_s)
        result = np.where(time_s >= knots[i], filtered[:-1], result)
        state = float(filtered[-1])
    return result
