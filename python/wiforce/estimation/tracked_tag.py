# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag as the separator follows it."""

from dataclasses import dataclass

import numpy as np

from ..signal.switching import switch_averages
from .clock import ClockTracker
from .likelihood import PhaseLikelihood
from .state import ClockState

_STEP_RAD = 1e-4


@dataclass(frozen=True)
class TagClock:
    """Nominal clock of one tag: fs and how far off it may be."""

    clock_hz: float
    tolerance_ppm: float = 100.0


class TrackedTag:
    """Everything that the separator keeps about one tag: its clock, when it was last heard."""

    def __init__(self, table, index, clock, averaging_s):
        self.clock = clock
        self.rows = slice(2 * index, 2 * index + 2)
        self.rate = 2 * np.pi * clock.clock_hz
        self.half_window = self.rate * averaging_s / 2
        self.likelihood = PhaseLikelihood(table, index, clock.clock_hz * averaging_s)
        self.overlapping = False
        self.tracker = None
        self.last_seen_s = None
        self.waiting = []

    def start(self, fit, times_s, subcarriers, noise_level):
        self.tracker = ClockTracker(fit, times_s, self.rate, subcarriers, noise_level)
        self.overlapping = fit.overlapping
        self.last_seen_s = times_s[-1]

    def drop(self):
        self.tracker = None
        self.waiting = []

    @property
    def delay(self):
        return self.tracker.likelihood.clock2_delay

    def waveforms(self, item):
        """s1 and s2 of every snapshot of a group."""
        return self._waveforms(item, 0.0)

    def slopes(self, item):
        """Their derivatives by the clock's phase."""
        later, sooner = (self._waveforms(item, turn) for turn in (_STEP_RAD, -_STEP_RAD))
        return (later - sooner) / (2 * _STEP_RAD)

    def _waveforms(self, item, turn):
        phase, rate = self.tracker.predict(item.center_s)
        phases = phase + turn + (self.rate + rate) * item.times_s
        return switch_averages(phases, self.half_window * (1 + rate / self.rate), self.delay)

    def state(self, item):
        seen = self.tracker is not None and self.last_seen_s >= item.center_s - 1e-9
        if not (seen and item.usable):
            return ClockState(False)
        phase, rate = self.tracker.predict(item.center_s)
        ppm = float(1e6 * rate / self.rate)
        return ClockState(True, float(phase % (2 * np.pi)), ppm, self.delay, self.overlapping)
