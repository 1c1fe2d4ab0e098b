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
from ..wiforce_kernels import INVERSION_FLAGS, press_outcome
from .evidence import Suspicion
from .explanations import (
    MIXED,
    PRESSED,
    UNEXPLAINED,
    UNTOUCHED,
    likeliest,
    probability,
    ratios_of,
)
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

    ``tracked`` follows every press over time (location constant, force a random walk) instead.
    ``surveyed_snr_db`` is the SNR of line 1 of the tag against the noise between the lines,
    ``tag_ratio`` the amplitude of the tag over that of the static path for two antennas,
    ``in_lamps`` whether strong lines of the tag coincide with those of lamps, and ``off_std`` the
    standard deviation of both parts of ``off_reflection``, G_off / rho of both switches.
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

    def take(self, groups: Groups, sensor: int, receiver: Array) -> tuple[Array, Array]:
        """Take the next groups; ``receiver`` (G, 3) is as ``receiver_steps`` gives it.

        Gives outcomes of the group before each of these, and flags of these, int, shape (G,), by
        the stages before.
        """
        found, retuned = self.state.take(groups, sensor, self._period_s, receiver)
        return found, stage_flags(groups, sensor) | retuned * Flag.MOVED.value

    def read(self, groups: Groups, sensor: int, found: Array, flags: Array) -> Readout:
        """Read groups by their outcomes and the flags (G,) of the stages before."""
        count = len(groups)
        readable = has_phases(groups, sensor)
        if not readable.all():
            found = found[readable[found["row"]]]
        if groups.common_std_deg.any():
            # What turned both ends in the group alone is as little known as the untouched line.
            found = found.copy()
            found["common_variance"] += np.radians(groups.common_std_deg[found["row"]]) ** 2
        state = found["is"]
        untouched, mixed, unexplained, doubtful, turning = (
            probability(found, which, count)
            for which in (
                state == UNTOUCHED,
                state == MIXED,
                state == UNEXPLAINED,
                (state != MIXED) & ~found["known"],
                found["turns"],
            )
        )
        either = np.minimum(untouched, 1 - untouched - mixed)
        first, there = likeliest(found, count)
        readable &= there
        touch = np.where(readable, (untouched <= 0.5).astype(int), -1)
        if not len(found):
            found, first = np.zeros(1, press_outcome), np.zeros(count, int)
        doubt = np.array([mixed, unexplained, np.maximum(either, doubtful)]) > DOUBT
        doubt_flags = _DOUBTS @ doubt | Flag.MOVED.value * (turning > 0.5)
        flags = flags | np.where(readable, doubt_flags, 0)
        unseen = ~readable & ~groups.overlapping[:, sensor]
        unseen &= (flags & ~(Flag.INCONSISTENT | Flag.AMBIGUOUS).value) == 0
        flags[unseen] |= Flag.WEAK.value
        best = found[first]
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
            self._invert(found, first, touched, values, flags)
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
    def _level(found: Array, shift: ArrayLike) -> Array:
        """R against the untouched line of each explanation, turned by ``shift``; shape (m, 2)."""
        turn = found["baseline"] + np.asarray(shift)[..., None]
        level: Array = ratios_of(found) * np.exp(-found["amplitude"][:, None] - 1j * turn)
        return level

    def _phases(self, found: Array, level: Array, whole: bool) -> tuple[Array, Array]:
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
            own = found["mean"]["variance"] + found["difference_variance"][:, None] / 4
            if self._tag_ratio:
                own = own + np.radians(curvature_deg(ratios_of(found), self._tag_ratio)) ** 2
            if whole:
                own = own + found["common_variance"][:, None]
            std = np.degrees(np.sqrt(own)) * slope
            if self._off_std:
                unsure = off_state_error_deg(level, self._untouched, self._off)
                std = np.hypot(std, self._off_std * unsure)
            return phases, std

    def _invert(
        self,
        found: Array,
        first: Array,
        touched: Array,
        values: Array,
        flags: Array,
    ) -> None:
        """Fill in force and location of touched groups."""
        count = len(touched)
        wanted = (found["is"] == PRESSED) & found["known"] & (found["weight"] > _LEAST_WEIGHT)
        wanted[first[touched]] = True
        wanted &= touched[found["row"]]
        chosen = np.flatnonzero(wanted)
        each, nodes = found[np.repeat(chosen, len(_NODES))], np.tile(_NODES, len(chosen))
        row, common = each["row"], np.sqrt(each["common_variance"]) * nodes
        phases, std = self._phases(each, self._level(each, common), False)
        inverted = self._model.invert(phases, std, frequency_hz=self._frequency_hz)
        weight = each["weight"] * np.tile(_SHARES, len(chosen))
        means = np.stack([inverted.force_n, inverted.location_mm], axis=1)
        spreads = np.stack([inverted.force_std_n, inverted.location_std_mm], axis=1)
        weight = np.where(np.isfinite(means).all(axis=1), weight, 0.0)
        means, spreads = np.nan_to_num(means), np.nan_to_num(spreads)
        total = np.bincount(row, weight, minlength=count)
        outside = np.zeros(len(weight), bool)
        with np.errstate(divide="ignore", invalid="ignore"):
            for column in (0, 1):
                mean = np.bincount(row, weight * means[:, column], minlength=count) / total
                square = spreads[:, column] ** 2 + (means[:, column] - mean[row]) ** 2
                second = np.bincount(row, weight * square, minlength=count) / total
                std = np.sqrt(second)
                outside |= np.abs(means[:, column] - mean[row]) > _FAR * std[row]
                values[touched, 2 * column] = mean[touched]
                values[touched, 2 * column + 1] = std[touched]
        far = np.bincount(row, weight * outside, minlength=count)
        flags[touched & (far > DOUBT * total)] |= Flag.AMBIGUOUS.value
        # Flags are those of the likeliest explanation, at the middle of its common phase. Phases
        # that changed inside the group are those of no press.
        heavy = np.full(len(found), -1)
        heavy[chosen] = np.arange(len(chosen))
        codes = inverted.codes[:: len(_NODES)][heavy[first[touched]]]
        flags[touched] |= np.where(found["is"][first[touched]] == MIXED, 0, _BITS[codes])

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


def as_arrays(readouts: list[Readout]) -> dict[str, Array]:
    """Arrays of :class:`Groups` from what the groups say of each sensor."""
    arrays = {
        name: np.array([getattr(each, name) for each in readouts]).swapaxes(0, 1)
        for name in ("touch", "phases_deg", "psi_std_deg", "flags")
    }
    values = np.array([each.values for each in readouts]).transpose(2, 1, 0)
    return arrays | dict(zip(ESTIMATES, values, strict=True))
