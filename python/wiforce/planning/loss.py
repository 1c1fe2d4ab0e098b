# SPDX-License-Identifier: GPL-3.0-or-later
"""Information lost by reading only some lines of the tags, known before anything is received."""

from collections.abc import Sequence

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..estimation.estimators import estimator_named
from ..scene import Scene
from ..signal.lines import CLUTTER_MARGIN, Tone, centered_times_s, clutter_basis, tag_lines
from ..signal.switching import switch_averages
from ..signal.timed_weights import clutter_at, timed_lines

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
    """Loss (2S,) in dB of each end from using lines +-1..+-harmonics, for several choices.

    Over least squares of all snapshots on [s1, s2, clutter], the mean over clock phases and signs
    of errors. Choices rise, as far as a group resolves them.
    """
    clocks_hz = [clock.clock_hz for clock in clocks]
    period_s, length = group_length * snapshot_period_s, min(group_length, _LONGEST)
    if times_s is None:
        at_s = centered_times_s(length, snapshot_period_s)
        clutter = clutter_basis(length, snapshot_period_s, clutter_hz)
    else:
        at_s, clutter = times_s, timed_clutter(times_s, period_s, clutter_hz)

    def tones(count: int, snapshots: int) -> Sequence[Tone]:
        if times_s is not None:
            return timed_lines(clocks_hz, times_s, period_s, clutter_hz, count)
        return tag_lines(clocks_hz, snapshot_period_s, snapshots, count, clutter_hz)

    waveforms = np.concatenate(
        [_waveforms(clocks, at_s, averaging_s, clutter, sign) for sign in (1, -1)]
    )
    whole = variances(waveforms).sum(axis=0)
    losses: dict[int, np.ndarray] = {}
    for count in choices:
        if losses and 2 * len(tones(count, group_length)) >= group_length:
            continue
        upper = [tone.frequency_hz for tone in tones(count, length) if tone.frequency_hz > 0]
        cycles = np.outer(at_s, upper)
        lines = np.hstack([np.cos(2 * np.pi * cycles), np.sin(2 * np.pi * cycles)])
        lines = np.linalg.qr(lines - clutter @ (clutter.T @ lines))[0]
        losses[count] = 10 * np.log10(variances(lines.T @ waveforms).sum(axis=0) / whole)
    return losses


def end_variances(
    clocks: Sequence[TagClock], times_s: np.ndarray, averaging_s: float, clutter: np.ndarray
) -> np.ndarray:
    """Variances (2S,) of ends over the noise in H, summed over phases, beside clutter."""
    waveforms = _waveforms(clocks, times_s, averaging_s, clutter)
    return np.asarray(variances(waveforms).sum(axis=0))


def timed_clutter(times_s: np.ndarray, period_s: float, clutter_hz: float) -> np.ndarray:
    """Orthonormal sequences (N, order) of clutter up to a frequency, at irregular times."""
    return np.linalg.qr(clutter_at(times_s, period_s, clutter_hz))[0]


def _waveforms(
    clocks: Sequence[TagClock],
    times_s: np.ndarray,
    averaging_s: float,
    clutter: np.ndarray,
    sign: int = 1,
) -> np.ndarray:
    """:func:`end_waveforms` of clocks at some phases, off by their tolerance in turns."""
    tags = np.arange(len(clocks))
    errors = sign * (-1.0) ** tags * [1e-6 * clock.planned_ppm for clock in clocks]
    starts = np.multiply.outer(_PHASES, 1 + tags * _PHASE_STEP)
    clocks_hz = np.array([clock.clock_hz for clock in clocks]) * (1 + errors)
    return end_waveforms(
        np.tile(clocks_hz, (len(starts), 1)), starts, times_s, averaging_s, clutter
    )


def end_waveforms(
    clocks_hz: np.ndarray,
    starts: np.ndarray,
    times_s: np.ndarray,
    averaging_s: float,
    clutter: np.ndarray,
) -> np.ndarray:
    """Waveforms (T, N, 2S) of clocks (T, S) at phases in cycles, beside clutter."""
    cycles = clocks_hz.T[..., None] * times_s + starts.T[..., None]
    half = np.pi * clocks_hz.T * averaging_s
    columns = [switch_averages(2 * np.pi * c, h) for c, h in zip(cycles, half, strict=True)]
    waveforms = np.concatenate(columns, axis=-1)
    waveforms -= clutter @ (clutter.T @ waveforms)
    return waveforms


def variances(waveforms: np.ndarray) -> np.ndarray:
    """Variances (..., 2S) by least squares of what has waveforms (..., N, 2S), in white noise."""
    # What has no energy left, but for rounding, is refused elsewhere.
    scale = np.sqrt(np.maximum(np.sum(waveforms**2, axis=-2), 1e-30))
    scaled = waveforms / scale[..., None, :]
    values, vectors = np.linalg.eigh(np.swapaxes(scaled, -1, -2) @ scaled)
    inverse = np.sum(vectors**2 / np.maximum(values, 1e-9)[..., None, :], axis=-1)
    return np.asarray(inverse / scale**2)


# Doppler of a person is 12 Hz at 900 MHz and 33 Hz at 2.4 GHz (2 m/s), that of a fan's blades 60 to
# 250 Hz.
BANDS_HZ = (250.0, 200.0, 150.0, 100.0, 60.0, 30.0)
# What rejecting clutter that may not exist may cost: 1.2 % of a standard deviation.
ACCEPTED_COST_DB = 0.1


def automatic_band_hz(
    clocks: Sequence[TagClock], group_length: int, snapshot_period_s: float, averaging_s: float
) -> float:
    """Widest clutter band, at most 250 Hz, that costs every end at most 0.1 dB, or 0."""
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
