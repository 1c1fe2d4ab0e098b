# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch, force, location and flags of one sensor: the mean over all explanations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.capture.antennas import curvature_deg
from ..estimation.groups import Array, Groups
from ..estimation.phases.off_state import (
    corrected_phase_deg,
    off_state_error_deg,
    off_states_differ,
    phase_on_circle_deg,
)
from ..io.readings import ESTIMATES, WEAK_FORCE_N, WEAK_PHASE_DEG, Flag, flag_bits
from ..wiforce_kernels import INVERSION_FLAGS
from .evidence import Suspicion
from .explanations import COLUMNS, MIXED, PRESSED, UNEXPLAINED, UNTOUCHED, Explanations
from .sensor_state import DOUBT, SensorState
from .stage_flags import has_phases, stage_flags

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

_NAN = math.nan
# Phase std above which a disturbance of the tag's own lines is flagged: most of it may be hidden.
_DISTURBED_DEG = 1.0
# The survey measures noise between the lines, the SNR of a reading includes what is left on them.
# It is up to 4 dB less in rooms that are read correctly, and 16 to 32 dB less beside a second tag
# on nearly the same clock where no other flag shows it (tests/rooms).
_LEFT_ON_LINES_DB = 15.0
# Flags of an inversion that finds no calibrated press.
_NO_PRESS = (Flag.INCONSISTENT | Flag.EXTRAPOLATED).value
# The flags of each code of an inversion.
_BITS = np.array(
    [
        flag_bits(tuple(word for word, value in INVERSION_FLAGS.items() if code & value))
        for code in range(2 * max(INVERSION_FLAGS.values()))
    ]
)
# Flags of a group in which something changes, nothing explains it, or there are several ways.
_DOUBTS = np.array([f.value for f in (Flag.TRANSITION, Flag.INCONSISTENT, Flag.AMBIGUOUS)])
# Explanations that are inverted.
_LEAST_WEIGHT = 1e-4
# Standard deviations beyond which a reading is wrong.
_FAR = 5.0
# Gauss-Hermite quadrature of a normal variable: nodes in standard deviations, and weights.
_NODES, _SHARES = np.array([0.0, -math.sqrt(3), math.sqrt(3)]), np.array([2 / 3, 1 / 6, 1 / 6])


class Readout(NamedTuple):
    """What a group says of a press: by the names of the arrays in Groups."""

    touch: Array
    phases_deg: Array
    psi_std_deg: Array
    values: Array
    flags: Array


class SensorReadout:
    """Inverts every explanation of a group, and gives the mean of all.

    Parameters
    ----------
    model : SensorModel
        Of the sensor.
    frequency_hz : float
        Carrier, in Hz.
    off_reflection : complex or array_like of two
        G_off / rho, per switch where they differ.
    group_period_s : float
        Length of a group, in s.
    state : SensorState
        Its record.
    tracked : bool
        Follow every press over time (location constant, force a random walk) instead of inverting
        each group by itself.
    surveyed_snr_db : float, optional
        SNR of line 1 of the tag against the noise between the lines.
    tag_ratio : float
        Amplitude of the tag over that of the static path, for two antennas; 0 for one.
    in_lamps : bool
        Whether strong lines of the tag coincide with those of lamps.
    off_std : float
        Standard deviation of the real and the imaginary part of each off state.
    """

    def __init__(
        self,
        model: SensorModel,
        frequency_hz: float,
        off_reflection: ArrayLike,
        group_period_s: float,
        state: SensorState,
        tracked: bool = False,
        surveyed_snr_db: float | None = None,
        tag_ratio: float = 0.0,
        in_lamps: bool = False,
        off_std: float = 0.0,
    ) -> None:
        self._model = model
        self._frequency_hz = frequency_hz
        self._surveyed_snr_db, self._tag_ratio = surveyed_snr_db, tag_ratio
        self._in_lamps = in_lamps
        self._period_s = group_period_s
        self._off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
        self._off_std = off_std
        self._untouched = np.array(model.untouched_deg(frequency_hz))
        self.state = state
        # Force and location of the newest group that was touched; NaN when unknown.
        self.force_n = self.location_mm = _NAN
        self._tracker = model.tracker(group_period_s, frequency_hz) if tracked else None
        model.inverter(frequency_hz)  # tabulates the model before samples arrive

    @property
    def suspicions(self) -> list[Suspicion]:
        """Mistakes that the presses since the last tare suggest."""
        return [] if self.state.evidence is None else self.state.evidence.suspicions

    def take(self, groups: Groups, sensor: int, receiver: Array) -> tuple[Explanations, Array]:
        """Take the next groups.

        Parameters
        ----------
        groups, sensor, receiver
            As for :meth:`SensorState.take`.

        Returns
        -------
        explanations : Explanations
            Of the group before each of these.
        flags : ndarray of int, shape (G,)
            Of these groups, by the stages before.
        """
        found, retuned = self.state.take(groups, sensor, self._period_s, receiver)
        return found, stage_flags(groups, sensor) | retuned * Flag.MOVED.value

    def read(self, groups: Groups, sensor: int, found: Explanations, flags: Array) -> Readout:
        """Read groups by their explanations.

        Parameters
        ----------
        groups : Groups
            With ``ratios``, ``phase_std_deg`` and the arrays of separation and reference.
        sensor : int
            Index of the sensor in them.
        found : Explanations
            Of these groups.
        flags : ndarray of int, shape (G,)
            By the stages before.

        Returns
        -------
        Readout
            ``values`` (G, 4): force, its standard deviation, location, its standard deviation.
        """
        count = len(groups)
        readable = has_phases(groups, sensor)
        if not readable.all():
            found = found.choose(readable[found.row])
        if groups.common_std_deg.any():
            # What turned both ends in the group alone is as little known as the untouched line.
            found = found.turned(np.radians(groups.common_std_deg) ** 2)
        shares = found.by_state(count)
        untouched, mixed, unexplained = shares[[UNTOUCHED, MIXED, UNEXPLAINED]]
        doubtful = found.probability((found.state != MIXED) & ~found.known, count)
        either = np.minimum(untouched, 1 - untouched - mixed)
        likeliest, there = found.likeliest(count)
        readable &= there
        touch = np.where(readable, (untouched <= 0.5).astype(int), -1)
        if not len(found.row):
            found = _nothing()
            likeliest = np.zeros(count, int)
        turning = found.probability(found.turns, count) > 0.5
        doubt = np.array([mixed, unexplained, np.maximum(either, doubtful)]) > DOUBT
        flags = flags | np.where(readable, _DOUBTS @ doubt | Flag.MOVED.value * turning, 0)
        unseen = ~readable & ~groups.overlapping[:, sensor]
        unseen &= (flags & ~(Flag.INCONSISTENT | Flag.AMBIGUOUS).value) == 0
        flags[unseen] |= Flag.WEAK.value
        best = found.choose(likeliest)
        level = self._level(best, 0.0)
        phases, std = self._phases(best, level, True)
        larger = std.max(axis=1)
        unsure = self._is_disturbed(groups, sensor) & (larger > _DISTURBED_DEG)
        flags[readable & unsure] |= Flag.INCONSISTENT.value
        flags[readable & (larger > WEAK_PHASE_DEG)] |= Flag.WEAK.value
        values, clear = np.full((count, 4), _NAN), flags == 0
        touched = readable & (touch == 1)
        if self._tracker is not None:
            self._track(phases, std, touched, readable, values, flags)
        elif touched.any():
            self._invert(found, likeliest, touched, values, flags)
        if self.state.evidence is not None:
            no_press = (flags & _NO_PRESS) != 0
            against = self.state.evidence.take(level, phases, std, touch, clear, no_press)
            flags[against] |= Flag.INCONSISTENT.value
        flags[touched & ~(values[:, 1] <= WEAK_FORCE_N)] |= Flag.WEAK.value
        phases[~readable] = _NAN
        if touched.any():
            self.force_n, _, self.location_mm, _ = values[touched][-1].tolist()
        return Readout(touch, phases, std, values, flags)

    @staticmethod
    def _level(found: Explanations, shift: ArrayLike) -> Array:
        """R against the untouched line of each explanation, turned by ``shift``; shape (m, 2)."""
        turn = found.baseline + np.asarray(shift)[..., None]
        return found.ratios * np.exp(-found.amplitude[:, None] - 1j * turn)

    def _phases(self, found: Explanations, level: Array, whole: bool) -> tuple[Array, Array]:
        """psi of both ends, degrees, by each explanation, and their standard deviations; (m, 2).

        ``level`` is R against the untouched line (:meth:`_level`). The variance is ``whole``, or
        without that of the common phase, which the nodes stand for.
        """
        with np.errstate(invalid="ignore"):
            if off_states_differ(self._off, self._off_std):
                # What turns the tag changes |R| of both ends as well.
                phases, slope = phase_on_circle_deg(level, self._untouched, self._off)
            else:
                phases, slope = corrected_phase_deg(level, self._untouched, self._off)
            own = found.variance + found.difference_variance[:, None] / 4
            if self._tag_ratio:
                own = own + np.radians(curvature_deg(found.ratios, self._tag_ratio)) ** 2
            if whole:
                own = own + found.common_variance[:, None]
            std = np.degrees(np.sqrt(own)) * slope
            if self._off_std:
                unsure = off_state_error_deg(level, self._untouched, self._off)
                std = np.hypot(std, self._off_std * unsure)
            return phases, std

    def _invert(
        self,
        found: Explanations,
        likeliest: Array,
        touched: Array,
        values: Array,
        flags: Array,
    ) -> None:
        """Fill in force and location of touched groups."""
        count = len(touched)
        wanted = (found.state == PRESSED) & found.known & (found.weight > _LEAST_WEIGHT)
        wanted[likeliest[touched]] = True
        wanted &= touched[found.row]
        chosen = np.flatnonzero(wanted)
        press = found.choose(chosen)
        at = np.repeat(np.arange(len(chosen)), len(_NODES))
        common = np.sqrt(press.common_variance)[at] * np.tile(_NODES, len(chosen))
        each = press.choose(at)
        phases, std = self._phases(each, self._level(each, common), False)
        inverted = self._model.invert(phases, std, frequency_hz=self._frequency_hz)
        weight = each.weight * np.tile(_SHARES, len(chosen))
        means = np.stack([inverted.force_n, inverted.location_mm], axis=1)
        spreads = np.stack([inverted.force_std_n, inverted.location_std_mm], axis=1)
        weight = np.where(np.isfinite(means).all(axis=1), weight, 0.0)
        means, spreads = np.nan_to_num(means), np.nan_to_num(spreads)
        total = np.bincount(each.row, weight, minlength=count)
        outside = np.zeros(len(weight), bool)
        with np.errstate(divide="ignore", invalid="ignore"):
            for column in (0, 1):
                first = np.bincount(each.row, weight * means[:, column], minlength=count) / total
                square = spreads[:, column] ** 2 + (means[:, column] - first[each.row]) ** 2
                second = np.bincount(each.row, weight * square, minlength=count) / total
                std = np.sqrt(second)
                outside |= np.abs(means[:, column] - first[each.row]) > _FAR * std[each.row]
                values[touched, 2 * column] = first[touched]
                values[touched, 2 * column + 1] = std[touched]
        far = np.bincount(each.row, weight * outside, minlength=count)
        flags[touched & (far > DOUBT * total)] |= Flag.AMBIGUOUS.value
        # Flags are those of the likeliest explanation, at the middle of its common phase. Phases
        # that changed inside the group are those of no press.
        heavy = np.full(len(found.row), -1)
        heavy[chosen] = np.arange(len(chosen))
        codes = inverted.codes[:: len(_NODES)][heavy[likeliest[touched]]]
        flags[touched] |= np.where(found.state[likeliest[touched]] == MIXED, 0, _BITS[codes])

    def _is_disturbed(self, groups: Groups, sensor: int) -> Array:
        """Whether something is received on the tag's own lines that is no noise; shape (G,)."""
        disturbed = np.full(len(groups), self._in_lamps)
        if groups.disturbed is not None:
            disturbed |= groups.disturbed[:, sensor]
        if self._surveyed_snr_db is not None and groups.snr_db is not None:
            snr_db = groups.snr_db[:, 2 * sensor : 2 * sensor + 2].min(axis=1)
            disturbed |= snr_db < self._surveyed_snr_db - _LEFT_ON_LINES_DB
        return disturbed

    def _track(
        self,
        phases: Array,
        std: Array,
        touched: Array,
        readable: Array,
        values: Array,
        flags: Array,
    ) -> None:
        assert self._tracker is not None
        for row in np.flatnonzero(readable):
            *found, words = self._tracker.update(phases[row], std[row], bool(touched[row]))
            if touched[row]:
                values[row] = [value if math.isfinite(value) else _NAN for value in found]
                flags[row] |= flag_bits(words)


def _nothing() -> Explanations:
    """One explanation of group 0 that says nothing, for batches without any."""
    return Explanations.of(np.zeros((1, COLUMNS)))


def as_arrays(readouts: list[Readout]) -> dict[str, Array]:
    """Arrays of :class:`Groups` from what the groups say of each sensor."""
    arrays = {
        name: np.array([getattr(each, name) for each in readouts]).swapaxes(0, 1)
        for name in ("touch", "phases_deg", "psi_std_deg", "flags")
    }
    values = np.array([each.values for each in readouts]).transpose(2, 1, 0)
    return arrays | dict(zip(ESTIMATES, values, strict=True))
