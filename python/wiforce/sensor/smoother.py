# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole press, each reading in the light of all of them."""

import numpy as np

from ..errors import InputError
from .inversion import inversion_of
from .tracker import FORCE_WALK_N, START_ABOVE_ONSET_N, PressTracker


def smooth_press(
    model,
    phases_deg,
    std_deg,
    group_period_s,
    frequency_hz=None,
    force_walk_n=FORCE_WALK_N,
    start_force_n=None,
    start_std_n=START_ABOVE_ONSET_N,
):
    """Force over a whole press and its location, each reading in the light of all of them.

    Parameters are those of :class:`.PressTracker`; ``phases_deg`` (n, 2) or (n, 2 C) and
    ``std_deg`` hold the readings of one press.

    Returns
    -------
    Inversion
        n readings.

    Raises
    ------
    InputError
    """
    phases = np.atleast_2d(np.asarray(phases_deg, float))
    if not phases.size:
        raise InputError("phases_deg", "must hold a reading or more", phases.shape)
    std = np.broadcast_to(np.asarray(std_deg, float), phases.shape)
    tracker = PressTracker(
        model, group_period_s, frequency_hz, force_walk_n, start_force_n, start_std_n
    )
    for reading, noise in zip(phases, std, strict=True):
        tracker.update(reading, noise)
    # once more, from the start, about where the press turned out to be
    bank = tracker.bank_about_result()
    history = []
    for i, (reading, noise) in enumerate(zip(phases, std, strict=True)):
        if i:
            bank.walk(tracker.walk_variance)
        before = bank.variance
        if np.all(np.isfinite(reading)):
            bank.update(reading, noise)
        history.append((before, bank.mean, bank.variance))
    return inversion_of(*_smoothed(history, bank, tracker, std))


def _smoothed(history, bank, tracker, std):
    """Rauch-Tung-Striebel per location, then the mixture of all: values (n, 6) and codes (n,)."""
    weight, location = bank.weights(), bank.curves.location_mm
    place, spread = bank.place()
    _, mean, variance = history[-1]
    rows = []
    for i in range(len(history) - 1, -1, -1):
        if i < len(history) - 1:
            before, (_, own_mean, own_variance) = history[i + 1][0], history[i]
            gain = own_variance / before
            mean = own_mean + gain * (mean - own_mean)
            variance = own_variance + gain**2 * (variance - before)
        force = weight @ mean
        away = mean - force
        covariance = tracker.systematic(force, place)
        covariance[0, 0] += weight @ (variance + away**2)
        covariance[1, 1] += spread
        shared = weight @ (away * (location - place))
        covariance += [[0.0, shared], [shared, 0.0]]
        rows.append([force, place, *covariance.ravel()])
    values = np.array(rows[::-1])
    codes = [tracker.code_of(row, noise) for row, noise in zip(values, std, strict=True)]
    return values, np.array(codes, np.uint8)
