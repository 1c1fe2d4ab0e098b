# SPDX-License-Identifier: GPL-3.0-or-later
"""What reading only some lines of the tags costs, before anything is received."""

import numpy as np

from ..signal.switching import switch_averages
from ..signal.weights import clutter_basis, tag_lines

# Clock phases that are tried; they matter only where aliases meet other lines.
_PHASES = (0.1, 0.37, 0.72)
# Longer groups resolve more, but lose no less.
_LONGEST = 1250


def line_loss_db(clocks, group_length, snapshot_period_s, averaging_s, clutter_hz, harmonics):
    """Loss of each end from taking only lines +-1..+-``harmonics``, clocks as far off as may be.

    Against least squares over all snapshots, [s1, s2, clutter], of the same group.

    Parameters
    ----------
    clocks : sequence of TagClock
    group_length : int
    snapshot_period_s, averaging_s : float
        T and Ta.
    clutter_hz : float
    harmonics : int

    Returns
    -------
    ndarray, shape (2S,)
        10 log10 of the ratio of variances; the mean over some clock phases and both signs of the
        clocks' errors.
    """
    clocks_hz = [clock.clock_hz for clock in clocks]
    group_length = min(group_length, _LONGEST)
    times_s = (np.arange(group_length) - (group_length - 1) / 2) * snapshot_period_s
    clutter = clutter_basis(group_length, snapshot_period_s, clutter_hz)
    tones = tag_lines(clocks_hz, snapshot_period_s, group_length, harmonics, clutter_hz)
    turns = np.outer(times_s, [tone.frequency_hz for tone in tones if tone.frequency_hz > 0])
    lines = np.hstack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    lines = np.linalg.qr(lines - clutter @ (clutter.T @ lines))[0]
    whole, taken = 0.0, 0.0
    for phase in _PHASES:
        for sign in (1, -1):
            waveforms = _waveforms(clocks, phase, sign, times_s, averaging_s)
            waveforms -= clutter @ (clutter.T @ waveforms)
            whole = whole + _variances(waveforms.T @ waveforms)
            seen = lines.T @ waveforms
            taken = taken + _variances(seen.T @ seen)
    return 10 * np.log10(taken / whole)


def _waveforms(clocks, phase, sign, times_s, averaging_s):
    columns = []
    for tag, clock in enumerate(clocks):
        clock_hz = clock.clock_hz * (1 + (-1) ** tag * sign * clock.tolerance_ppm * 1e-6)
        # each tag at a phase of its own
        cycles = clock_hz * times_s + phase * (1 + tag * 0.618)
        columns.append(switch_averages(2 * np.pi * cycles, np.pi * clock_hz * averaging_s))
    return np.hstack(columns)


def _variances(gram):
    """Of the ends; pseudo-inverse, since a design that cannot be is refused elsewhere."""
    return np.maximum(np.diag(np.linalg.pinv(gram, rcond=1e-12, hermitian=True)), 1e-300)
