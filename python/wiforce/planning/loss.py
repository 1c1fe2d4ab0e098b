# SPDX-License-Identifier: GPL-3.0-or-later
"""Information lost by reading only some lines of the tags, known before anything is received."""

from collections.abc import Sequence

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..estimation.estimators import estimator_named
from ..scene import Scene
from ..signal.lines import CLUTTER_MARGIN, centered_times_s, clutter_basis, tag_lines
from ..signal.switching import switch_averages
from ..signal.timed_weights import TimedTable, clutter_at, timed_lines, timed_table

# Clock phases that are tried, in cycles; they matter only where aliases meet other lines.
_PHASES = (0.1, 0.37, 0.72)
# Each tag's phase lies this part of a cycle (the golden section) after that of the one before.
_PHASE_STEP = 0.618
# Longer groups resolve more, but lose no less; the same band costs less.
_LONGEST = 1250


def losses_db(
    choices: Sequence[int],
    clocks: Sequence[TagClock],
    group_length: int,
    snapshot_period_s: float,
    averaging_s: float,
    clutter_hz: float,
    times_s: np.ndarray | None = None,
) -> dict[int, np.ndarray]:
    """Loss of each end as :func:`line_loss_db` for several numbers of harmonics, rising.

    Those of which a group resolves the lines, and the first one in any case. ``times_s`` (N,) are
    irregular times of the snapshots from the group's centre.
    """
    clocks_hz, period_s = [clock.clock_hz for clock in clocks], group_length * snapshot_period_s
    losses: dict[int, np.ndarray] = {}
    for count in choices:
        if times_s is None:
            lines = tag_lines(clocks_hz, snapshot_period_s, group_length, count, clutter_hz)
        else:
            lines = timed_lines(clocks_hz, times_s, period_s, clutter_hz, count)
        if losses and 2 * len(lines) >= group_length:
            continue
        if times_s is None:
            settings = group_length, snapshot_period_s, averaging_s, clutter_hz, count
            losses[count] = line_loss_db(clocks, *settings)
        else:
            table = timed_table(clocks_hz, times_s, period_s, clutter_hz, count)
            losses[count] = timed_loss_db(clocks, table, averaging_s)
    return losses


def timed_loss_db(clocks: Sequence[TagClock], table: TimedTable, averaging_s: float) -> np.ndarray:
    """As :func:`line_loss_db`, for the lines of a table of irregular times."""
    times_s = table.times_s
    clutter = np.linalg.qr(clutter_at(times_s, table.group_period_s, table.clutter_hz))[0]
    upper = [tone.frequency_hz for tone in table.tones if tone.frequency_hz > 0]
    return _loss_db(clocks, times_s, averaging_s, clutter, upper)


def line_loss_db(
    clocks: Sequence[TagClock],
    group_length: int,
    snapshot_period_s: float,
    averaging_s: float,
    clutter_hz: float,
    harmonics: int,
) -> np.ndarray:
    """Loss (2S,) in dB of each end from using only lines +-1..+-``harmonics``, clocks off by their
    tolerance.

    Ratio of an end's variance to that of least squares over all snapshots of the same group, [s1,
    s2, clutter]; the mean over some clock phases and both signs of the clocks' errors. N snapshots
    of period T average over Ta; what moves has Doppler frequencies up to ``clutter_hz``.
    """
    clocks_hz = [clock.clock_hz for clock in clocks]
    group_length = min(group_length, _LONGEST)
    times_s = centered_times_s(group_length, snapshot_period_s)
    clutter = clutter_basis(group_length, snapshot_period_s, clutter_hz)
    tones = tag_lines(clocks_hz, snapshot_period_s, group_length, harmonics, clutter_hz)
    upper = [tone.frequency_hz for tone in tones if tone.frequency_hz > 0]
    return _loss_db(clocks, times_s, averaging_s, clutter, upper)


def _loss_db(
    clocks: Sequence[TagClock],
    times_s: np.ndarray,
    averaging_s: float,
    clutter: np.ndarray,
    lines_hz: Sequence[float],
) -> np.ndarray:
    cycles = np.outer(times_s, lines_hz)
    lines = np.hstack([np.cos(2 * np.pi * cycles), np.sin(2 * np.pi * cycles)])
    lines = np.linalg.qr(lines - clutter @ (clutter.T @ lines))[0]
    grams = []
    for phase in _PHASES:
        for sign in (1, -1):
            waveforms = _waveforms(clocks, phase, sign, times_s, averaging_s)
            waveforms -= clutter @ (clutter.T @ waveforms)
            projected = lines.T @ waveforms
            grams.append([waveforms.T @ waveforms, projected.T @ projected])
    whole, used = _variances(np.array(grams)).sum(axis=0)
    return np.asarray(10 * np.log10(used / whole))


def end_variances(
    clocks: Sequence[TagClock], times_s: np.ndarray, averaging_s: float, clutter: np.ndarray
) -> np.ndarray:
    """Variances (2S,) of the ends by least squares over all snapshots of a group, clutter projected
    out.

    In units of the noise in H; the sum over some clock phases. ``clutter`` (N, order) is
    orthonormal.
    """
    grams = []
    for phase in _PHASES:
        waveforms = _waveforms(clocks, phase, 1, times_s, averaging_s)
        waveforms -= clutter @ (clutter.T @ waveforms)
        grams.append(waveforms.T @ waveforms)
    return np.asarray(_variances(np.array(grams)).sum(axis=0))


def _waveforms(
    clocks: Sequence[TagClock], phase: float, sign: int, times_s: np.ndarray, averaging_s: float
) -> np.ndarray:
    """Switching waveforms as columns, shape (N, 2S); clocks off in alternating directions."""
    columns = []
    for tag, clock in enumerate(clocks):
        clock_hz = clock.clock_hz * (1 + (-1) ** tag * sign * clock.planned_ppm * 1e-6)
        cycles = clock_hz * times_s + phase * (1 + tag * _PHASE_STEP)
        columns.append(switch_averages(2 * np.pi * cycles, np.pi * clock_hz * averaging_s))
    return np.hstack(columns)


def _variances(grams: np.ndarray) -> np.ndarray:
    """Of the ends, (..., 2S), of matrices (..., 2S, 2S); singular designs are refused elsewhere."""
    inverse = np.linalg.pinv(grams, rcond=1e-12, hermitian=True)
    return np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1), 1e-300)


# Doppler of a person is 12 Hz at 900 MHz and 33 Hz at 2.4 GHz (2 m/s), that of a fan's blades 60 to
# 250 Hz.
BANDS_HZ = (250.0, 200.0, 150.0, 100.0, 60.0, 30.0)
# What rejecting clutter that may not exist may cost: 1.2 % of a standard deviation.
ACCEPTED_COST_DB = 0.1


def automatic_band_hz(
    clocks: Sequence[TagClock], group_length: int, snapshot_period_s: float, averaging_s: float
) -> float:
    """Widest clutter band, at most 250 Hz, that costs every end at most 0.1 dB.

    Rejecting a wide band from the start makes a room in which something begins to move as good as
    one in which it moved all the time, and costs nothing per sample. 0 for groups that are too
    short to reject anything but the mean.
    """
    group_length = min(group_length, _LONGEST)
    resolution_hz = 1 / (group_length * snapshot_period_s)
    highest_hz = min(clock.clock_hz for clock in clocks) - CLUTTER_MARGIN * resolution_hz
    times_s = centered_times_s(group_length, snapshot_period_s)
    still = end_variances(clocks, times_s, averaging_s, clutter_basis(group_length, 1.0, 0.0))
    for band_hz in BANDS_HZ:
        if band_hz >= highest_hz:
            continue
        clutter = clutter_basis(group_length, snapshot_period_s, band_hz)
        cost = end_variances(clocks, times_s, averaging_s, clutter) / still
        if 10 * np.log10(cost.max()) <= ACCEPTED_COST_DB:
            return band_hz
    return 0.0


def clutter_band_hz(scene: Scene, clocks: Sequence[TagClock]) -> float:
    """The scene's clutter band in Hz, or one that costs hardly anything where it states none."""
    stated_hz = scene.environment.moving_clutter_hz
    if stated_hz is not None:
        return stated_hz
    # Every sequence that is rejected at irregular times costs a packet's worth of information, so
    # that nothing is rejected before a survey has found something.
    if scene.packets or estimator_named(scene.phase_group.estimator).rectangular:
        return 0.0
    waveform = scene.waveform()
    return automatic_band_hz(
        clocks, scene.phase_group.snapshots, waveform.snapshot_period_s, waveform.averaging_s
    )


# Of the typical group's times; any other seed gives the same expected errors within 0.1 dB.
_SEED = 1


def typical_times_s(scene: Scene) -> np.ndarray:
    """Rising times (N,) of the packets of a typical phase group, from its centre."""
    count, period_s = scene.phase_group.snapshots, scene.group_period_s
    if scene.packets is not None and scene.packets.gaps == "regular":
        return (np.arange(count) + 0.5) * (period_s / count) - period_s / 2
    # Given their number, the times of a Poisson process are uniform.
    return np.sort(np.random.default_rng(_SEED).uniform(-period_s / 2, period_s / 2, count))
