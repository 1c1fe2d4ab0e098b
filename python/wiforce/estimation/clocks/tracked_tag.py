# SPDX-License-Identifier: GPL-3.0-or-later
"""State of one tag during the separation: its clock, tracked from group to group, and pulses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...signal.switching import switch_averages, switch_averages_and_slopes
from ...signal.weights import ToneTable
from ...wiforce_kernels import clock_tracker, locked_tag
from ..groups import Array, GroupTones
from .likelihood import (
    ClockFit,
    PhaseLikelihood,
    evaluate,
    most_likely,
    nearest_maximum,
    turned_by,
)


class ClockPath(NamedTuple):
    """Clock phases in rad and rates above nominal in rad/s, (G, ...), at the centres of groups."""

    phase: Array
    rate: Array

    def of(self, tag: int, rows: slice = slice(None)) -> ClockPath:
        """The path of one of the tags, in some of the groups."""
        return ClockPath(self.phase[rows, tag], self.rate[rows, tag])


class ClockTracker(clock_tracker):
    """Tracks a tag's clock and its likelihood, from a fit of L groups at ``times_s`` (L,) on."""

    rate: float  # above nominal, of the kernel's class

    def __init__(
        self,
        fit: ClockFit,
        times_s: Array,
        nominal_rate: float,
        subcarriers: int,
        noise_level: float,
    ) -> None:
        elapsed = times_s - times_s.mean()
        precision = max(float(np.sum(elapsed**2)), 1e-12)
        phases = fit.phase + (nominal_rate + fit.rate) * elapsed
        energy, _, curvature = evaluate(turned_by(fit.coefficients, phases))
        super().__init__()
        self.time_s, self.phase, self.rate = fit.time_s, fit.phase, fit.rate
        self.variances = (fit.variance / len(elapsed), 0.0, fit.variance / precision)
        self.nominal_rate, self.subcarriers = nominal_rate, subcarriers
        self.slope_variance = subcarriers * fit.likelihood.noise_variance
        # J and J'' of a mean group, independent of the noise level, which may change.
        self.energy = noise_level * float(energy.mean())
        self.curvature = noise_level * float(curvature.mean())
        self.groups, self.seen_s = len(elapsed), float(times_s[-1])
        self.likelihood = fit.likelihood
        # Times of the latest groups and J of them by the complete model.
        self.latest: list[tuple[float, Array]] = []

    def __copy__(self) -> ClockTracker:
        other = ClockTracker.__new__(ClockTracker)
        clock_tracker.__init__(other, self)
        other.__dict__ = dict(self.__dict__)
        return other

    def place(self, at_s: float, tolerance_ppm: float = 0.0) -> None:
        """Set the clock to the most likely one of the latest groups, near rate or tolerance."""
        times_s, coefficients = (np.array(each) for each in zip(*self.latest, strict=True))
        elapsed, former = times_s - at_s, 0.0 if tolerance_ppm else self.rate
        near = elapsed, self.nominal_rate + former, tolerance_ppm
        rate, self.phase = most_likely(coefficients, *near)
        # The kernel corrects it by no more than clocks drift.
        self.time_s, self.rate, self.variances = at_s, former + rate, (0.0, 0.0, 0.0)

    def correct(self, errors: Array, variances: Array) -> None:
        """Correct phase and rate by their errors (2,) with known variances (2,)."""
        if not np.all(np.isfinite(variances)):
            return
        self.phase += float(errors[0])
        self.rate += float(errors[1])
        self.variances = (float(variances[0]), 0.0, float(variances[1]))


# Clocks of a wider tolerance than the first are searched for in the survey of a recording. This is
# what remains of their tolerance: they wander by some 20 ppm per root of a second. Those of a wider
# tolerance than the second cannot be read without a survey, since the weights of a run are fixed.
ACQUIRED_PPM = 300.0
WIDEST_PPM = 1000.0


@dataclass(frozen=True)
class TagClock:
    """Clock of one tag, as far as it is known before a run."""

    clock_hz: float  # fs, nominal, or as a survey has measured it
    tolerance_ppm: float = 100.0  # largest offset of the clock from that
    nominal_hz: float | None = None  # what offsets are reported against; None for ``clock_hz``

    @property
    def stated_hz(self) -> float:
        """Clock that the scene states, in Hz."""
        return self.clock_hz if self.nominal_hz is None else self.nominal_hz

    @property
    def wide(self) -> bool:
        """Whether the clock is searched for in a survey."""
        return self.tolerance_ppm > ACQUIRED_PPM

    @property
    def wanders(self) -> bool:
        """Whether the phase of the clock changes inside a group, as without a crystal."""
        return self.tolerance_ppm >= ACQUIRED_PPM

    @property
    def planned_ppm(self) -> float:
        """Largest offset that weights have to allow for, in ppm."""
        return self.tolerance_ppm if self.tolerance_ppm <= WIDEST_PPM else ACQUIRED_PPM


class TrackedTag:
    """State of one tag: its ``rows`` among all ends, and a ``tracker``, None while it is not known.

    ``likelihood`` has the duty cycles found, once ``pulses_known``, and no delay of clock 2;
    ``waiting`` are the latest groups, over which a lost tag is acquired again.
    """

    def __init__(self, table: ToneTable, index: int, clock: TagClock, averaging_s: float) -> None:
        self.clock = clock
        self.rows = range(2 * index, 2 * index + 2)
        self.rate = 2 * np.pi * clock.clock_hz
        self.averaging_s = averaging_s
        self.likelihood = PhaseLikelihood(table, index, clock.clock_hz * averaging_s)
        self.overlapping = self.pulses_known = False
        self.tracker: ClockTracker | None = None
        self.waiting: list[GroupTones] = []

    def start(self, fit: ClockFit, times_s: Array, subcarriers: int, noise_level: float) -> None:
        """Track the clock of a fit to groups at ``times_s``, scaled by a ``noise_level``."""
        self.tracker = ClockTracker(fit, times_s, self.rate, subcarriers, noise_level)
        self.overlapping = fit.overlapping

    def drop(self) -> None:
        """Discard the clock: the tag has to be acquired again."""
        self.tracker = None
        self.waiting = []

    def locked(self) -> locked_tag:
        """The tag as the kernels take it, while its clock is tracked."""
        assert self.tracker is not None
        return locked_tag(
            self.rows[0] // 2,
            self.tracker,
            self.tracker.likelihood.kernel,
            self.likelihood.rows.tolist(),
            self.rate,
            2 * np.pi * self.clock.stated_hz,
            self.clock2_delay,
            self.duty,
            self.overlapping,
        )

    @property
    def clock2_delay(self) -> float:
        """Delay of clock 2's pulses, in radians of clock 1."""
        return self.tracker.likelihood.clock2_delay if self.tracker else 0.0

    @property
    def duty(self) -> tuple[float, float]:
        """Duty cycles of clocks 1 and 2."""
        return self.likelihood.duty

    def waveforms_and_slopes(self, clock: ClockPath, times_s: Array) -> tuple[Array, Array]:
        """s_1 and s_2 averaged over snapshots at ``times_s`` (n,), and slopes; (G, n, 2)."""
        phases = np.multiply.outer(self.rate + clock.rate, times_s)
        phases += clock.phase[:, None]
        half_window = (self.rate + clock.rate) * self.averaging_s / 2
        return switch_averages_and_slopes(phases, half_window, self.clock2_delay, self.duty)


# Clock phases and channels of the two ends at which the bias is evaluated. A grid of 24 phases
# finds up to twice as much (0.21 instead of 0.09 deg with 600 snapshots, 1 kHz); the threshold in
# clock_search.py holds for this grid.
_PHASES = 0.1 + 2 * np.pi * np.arange(6) / 6
_ENDS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [1, 1j], [1, -1j]]).T


def likelihood_bias(
    table: ToneTable, likelihood: PhaseLikelihood, clock: TagClock, averaging_s: float
) -> float:
    """Largest bias in rad, without noise, of the phase of highest likelihood, over all channels."""
    largest = 0.0
    for offset in (-1, 0, 1):
        rate = 2 * np.pi * clock.clock_hz * (1 + offset * 1e-6 * clock.tolerance_ppm)
        courses = _PHASES[:, None] + rate * table.times_s
        waveforms = switch_averages(courses, rate * averaging_s / 2)
        tones = table.weights[likelihood.rows] @ waveforms @ _ENDS
        own = tones.swapaxes(1, 2)[..., None]
        coefficients = likelihood.coefficients(likelihood.covariance(own, np.ones(1)))
        found = nearest_maximum(coefficients, np.repeat(_PHASES[:, None], _ENDS.shape[1], axis=1))
        largest = max(largest, float(np.abs(found - _PHASES[:, None]).max()))
    return largest
