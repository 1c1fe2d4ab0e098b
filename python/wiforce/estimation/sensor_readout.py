# SPDX-License-Identifier: GPL-3.0-or-later
"""One sensor: from its ratios R to touch, force, location and flags."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..io.readings import WEAK_FORCE_N, WEAK_PHASE_DEG, Flag, flag_bits
from .groups import Array, Groups
from .motion import TouchedMotion
from .off_state import corrected_phase_deg
from .touch import TouchDetector

_NAN = math.nan
_VALUES = ("force_n", "force_std_n", "location_mm", "location_std_mm")


class SensorReadout:
    """One sensor's part: decides touch, takes the off state out, inverts.

    Parameters
    ----------
    model : SensorModel
    frequency_hz : float
        Carrier.
    off_reflection : complex or sequence of two
        G_off / rho, per switch where they differ.
    group_period_s : float
    tracked : bool
        Follow every press over time (location constant, force a random walk) instead of inverting
        each group by itself.
    """

    def __init__(
        self,
        model: Any,
        frequency_hz: float,
        off_reflection: Any,
        group_period_s: float,
        tracked: bool = False,
    ) -> None:
        self._model = model
        self._frequency_hz = frequency_hz
        self._period_s = group_period_s
        self._off = np.asarray(off_reflection, complex)
        self._untouched = np.array(model.untouched_deg(frequency_hz))
        self._touch = TouchDetector(self._image(), group_period_s)
        self._motion = TouchedMotion()
        self._retuned = False
        self._tracker = model.tracker(group_period_s, frequency_hz) if tracked else None
        if not tracked:
            model.inverter(frequency_hz).prepare()  # not while samples wait

    def read(self, groups: Groups, sensor: int) -> dict[str, Array]:
        """Touch, phases, force, location and flags of one sensor in a batch.

        Parameters
        ----------
        groups : Groups
            With ``ratios`` and ``phase_std_deg``.
        sensor : int
            Index of the sensor.

        Returns
        -------
        dict of str to ndarray, shape (G,) or (G, 2)
            By the names of the arrays in Groups; all flags but ``transition``.
        """
        ends = slice(2 * sensor, 2 * sensor + 2)
        ratios, std = groups.ratios[:, ends], groups.phase_std_deg[:, ends]
        flags, there = self._what_is_known(groups, sensor, ratios, std)
        touch, drift = self._decide_touch(groups, ends, ratios, std, flags, there)
        level = ratios * np.exp(-1j * np.radians(drift))
        with np.errstate(invalid="ignore"):
            phases, slope = corrected_phase_deg(level, self._untouched, self._off)
            std = std * slope
        weak = there & (std.max(axis=1) > WEAK_PHASE_DEG)
        flags[weak] |= Flag.WEAK.value
        values = np.full((len(groups), 4), _NAN)
        if self._tracker is not None:
            self._track(phases, std, touch, there, values, flags)
        elif (touched := np.flatnonzero(touch == 1)).size:
            values[touched], raised = self._invert(phases[touched], std[touched])
            flags[touched] |= raised
        uncertain = (touch == 1) & ~(values[:, 1] <= WEAK_FORCE_N)
        flags[uncertain] |= Flag.WEAK.value
        self._watch_motion(phases, std, touch, there, values, flags)
        phases[~there] = _NAN
        return {
            "touch": touch,
            "phases_deg": phases,
            "flags": flags,
            **dict(zip(_VALUES, values.T, strict=True)),
        }

    def _image(self) -> Array:
        """Changes of arg R that a touch can make; shape (n, 2)."""
        top = 1.3 * self._model.force_span_n[1]
        forces = np.geomspace(max(self._model.onset_force_n, 0.05), top, 30)
        locations = np.arange(0.0, self._model.length_mm + 0.5)
        grid = np.stack(np.meshgrid(forces, locations), -1).reshape(-1, 2)
        phases = self._model.phases_deg(grid[:, 0], grid[:, 1], self._frequency_hz)
        reflections = np.exp(1j * np.radians(phases))
        untouched = np.exp(1j * np.radians(self._untouched))
        return np.degrees(np.angle((reflections - self._off) / (untouched - self._off)))

    def _what_is_known(
        self, groups: Groups, sensor: int, ratios: Array, std: Array
    ) -> tuple[Array, Array]:
        """Flags of each group before it is read, and whether it can be; shape (G,)."""
        ends = slice(2 * sensor, 2 * sensor + 2)
        # The oscillator's phase is another one: without a new reference both ends are turned.
        retuned = np.full(len(groups), self._retuned)
        for row in np.flatnonzero(groups.retuned | groups.new_reference):
            self._retuned = bool(groups.retuned[row]) or (
                self._retuned and not groups.new_reference[row]
            )
            retuned[row:] = self._retuned
        overlapping = groups.overlapping[:, sensor]
        late = groups.late_reference[:, ends].any(axis=1)
        raised = {
            Flag.REFERENCE: groups.in_reference[:, ends].any(axis=1),
            Flag.GAP: groups.missing > 0,
            Flag.SATURATED: groups.saturated,
            Flag.MOVED: retuned | groups.reshaped[:, ends].any(axis=1),
            Flag.INCONSISTENT: overlapping | late,
        }
        flags = np.zeros(len(groups), np.int64)
        for flag, rows in raised.items():
            flags[rows] |= flag.value
        there = groups.locked[:, sensor] & np.isfinite(std).all(axis=1) & ~overlapping
        there &= (np.abs(ratios) > 0).all(axis=1)
        unexplained = ~there & ~overlapping & ((flags & ~Flag.INCONSISTENT.value) == 0)
        flags[unexplained] |= Flag.WEAK.value
        return flags, there

    def _decide_touch(
        self,
        groups: Groups,
        ends: slice,
        ratios: Array,
        std: Array,
        flags: Array,
        there: Array,
    ) -> tuple[Array, Array]:
        """Touch (G,), -1 where it is unknown, and the drift (G, 2) that the tare takes off."""
        touch, drift = np.full(len(groups), -1), np.zeros((len(groups), 2))
        times_s = ((groups.index + 0.5) * self._period_s).tolist()
        changes = np.degrees(np.angle(ratios)).tolist()
        stds = std.tolist()
        in_reference = groups.in_reference[:, ends].any(axis=1).tolist()
        for row, anew in enumerate(groups.new_reference.tolist()):
            if anew:
                self._touch.tare()
            if not there[row]:
                continue
            decision = self._touch.update(times_s[row], changes[row], stds[row], in_reference[row])
            touch[row], drift[row] = decision.touch, decision.drift_deg
            if decision.moved:
                flags[row] |= Flag.MOVED.value
            if decision.disturbed:
                flags[row] |= Flag.INCONSISTENT.value
        return touch, drift

    def _invert(self, phases: Array, std: Array) -> tuple[Array, Array]:
        """Force, its std, location, its std (n, 4), and flags (n,) of touched groups."""
        found = self._model.invert(phases, std, frequency_hz=self._frequency_hz)
        values = np.column_stack([getattr(found, name) for name in _VALUES])
        values[~np.isfinite(values)] = _NAN
        return values, np.array([flag_bits(words) for words in found.flags])

    def _track(
        self, phases: Array, std: Array, touch: Array, there: Array, values: Array, flags: Array
    ) -> None:
        assert self._tracker is not None
        for row in np.flatnonzero(there):
            touched = touch[row] == 1
            *found, words = self._tracker.update(phases[row], std[row], touched)
            if touched:
                values[row] = [value if math.isfinite(value) else _NAN for value in found]
                flags[row] |= flag_bits(words)

    def _watch_motion(
        self, phases: Array, std: Array, touch: Array, there: Array, values: Array, flags: Array
    ) -> None:
        touches, locations = touch.tolist(), values[:, 2].tolist()
        spreads = np.nan_to_num(values[:, 3]).tolist()
        known = there.tolist()
        for row, location_mm in enumerate(locations):
            if not known[row]:
                continue
            if touches[row] != 1:
                self._motion.forget()
            elif not math.isnan(location_mm):
                turned = self._motion.update(
                    phases[row].tolist(), std[row].tolist(), location_mm, spreads[row]
                )
                if turned:
                    flags[row] |= Flag.MOVED.value
