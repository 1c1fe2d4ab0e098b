# SPDX-License-Identifier: GPL-3.0-or-later
"""From the ratios R of a group to readings: off state, touch, tare, sensor model, flags."""

import math

import numpy as np

from ..io.readings import WEAK_FORCE_N, WEAK_PHASE_DEG, GroupCounts, Reading
from .estimators import RatioUnfolder
from .off_state import corrected_phase_deg
from .touch import TouchDetector, TouchedMotion

# |R| below this part of its neighbours' says that the press changed inside the group.
_DIP = 0.97
# Standard deviation over a neighbour's from which another sensor's change shows in a group.
_DISTURBED = 1.5
# Longest hole in the stream that is filled with rows flagged "gap".
_LONGEST_GAP_S = 3600.0


class _SensorReadout:
    """One sensor's part: decides touch, then inverts; knows its groups one by one."""

    def __init__(self, name, model, frequency_hz, off_reflection, group_period_s, tracked):
        self.name = name
        self._model = model
        self._frequency_hz = frequency_hz
        self._off = np.asarray(off_reflection, complex)
        self._untouched = np.array(model.untouched_deg(frequency_hz))
        self._touch = TouchDetector(self._image(), group_period_s)
        self._motion = TouchedMotion()
        self._retuned = False
        self._tracker = model.tracker(group_period_s, frequency_hz) if tracked else None
        if not tracked:
            model.inverter(frequency_hz)  # its table takes a second, not while samples wait

    def tare(self):
        self._touch.tare()
        self._retuned = False

    def _image(self):
        """Changes of arg R that a touch can make; shape (n, 2)."""
        top = 1.3 * self._model.force_span_n[1]
        forces = np.geomspace(max(self._model.onset_force_n, 0.05), top, 30)
        locations = np.arange(0.0, self._model.length_mm + 0.5)
        grid = np.stack(np.meshgrid(forces, locations), -1).reshape(-1, 2)
        phases = self._model.phases_deg(grid[:, 0], grid[:, 1], self._frequency_hz)
        reflections = np.exp(1j * np.radians(phases))
        untouched = np.exp(1j * np.radians(self._untouched))
        return np.degrees(np.angle((reflections - self._off) / (untouched - self._off)))

    def read(self, time_s, ratios, state, ends, clock):
        """Everything about a group but what its neighbours tell.

        Returns
        -------
        dict
            Fields of :class:`Reading`, flags as a list.
        """
        std = state.std_deg[ends]
        in_reference = bool(np.any(state.in_reference[ends]))
        flags = ["reference"] if in_reference else []
        if state.missing:
            flags.append("gap")
        if state.saturated:
            flags.append("saturated")
        # The oscillator's phase is another one: without a new reference both ends are turned.
        self._retuned = self._retuned or bool(state.retuned)
        if self._retuned or np.any(state.reshaped[ends]):
            flags.append("moved")
        there = clock.locked and bool(np.all(np.isfinite(std))) and bool(np.all(np.abs(ratios) > 0))
        if clock.overlapping or np.any(state.late_reference[ends]):
            flags.append("inconsistent")
        there = there and not clock.overlapping
        fields = {"time_s": time_s, "sensor": self.name, "flags": flags}
        if not there:
            if not clock.overlapping and flags in ([], ["inconsistent"]):
                flags.append("weak")
            return fields
        decision = self._touch.update(time_s, np.degrees(np.angle(ratios)), std, in_reference)
        if decision.moved and "moved" not in flags:
            flags.append("moved")
        if decision.disturbed and "inconsistent" not in flags:
            flags.append("inconsistent")
        level = ratios * np.exp(-1j * np.radians(decision.drift_deg))
        phases, slope = corrected_phase_deg(level, self._untouched, self._off)
        std = std * slope
        fields |= {
            "touch": decision.touch,
            "phase1_deg": float(phases[0]),
            "phase2_deg": float(phases[1]),
            "snr_db": float(np.min(state.snr_db[ends])),
        }
        if np.max(std) > WEAK_PHASE_DEG:
            flags.append("weak")
        if decision.touch == 1 or self._tracker is not None:
            self._invert(fields, phases, std, decision.touch == 1)
        self._watch_motion(fields, phases, std)
        return fields

    def _watch_motion(self, fields, phases, std):
        if fields["touch"] != 1:
            self._motion.forget()
        elif fields.get("location_mm") is not None:
            place_std = fields["location_std_mm"] or 0.0
            turned = self._motion.update(phases, std, fields["location_mm"], place_std)
            if turned and "moved" not in fields["flags"]:
                fields["flags"].append("moved")

    def _invert(self, fields, phases, std, touched):
        if self._tracker is not None:
            values = self._tracker.update(phases, std, touched)
            if not touched:
                return
        else:
            result = self._model.invert(phases[None], std, frequency_hz=self._frequency_hz)
            values = (
                result.force_n[0],
                result.force_std_n[0],
                result.location_mm[0],
                result.location_std_mm[0],
                result.flags[0],
            )
        names = ("force_n", "force_std_n", "location_mm", "location_std_mm")
        numbers = [float(v) if math.isfinite(v) else None for v in values[:4]]
        fields |= dict(zip(names, numbers, strict=True))
        flags = fields["flags"]
        flags.extend(flag for flag in values[4] if flag not in flags)
        force_std = fields["force_std_n"]
        if "weak" not in flags and (force_std is None or force_std > WEAK_FORCE_N):
            flags.append("weak")


class Readout:
    """Readings of all sensors of a scene, group by group.

    A reading leaves one group late: whether the press changed inside a group shows against its
    neighbours.

    Parameters
    ----------
    sensors : sequence of (name, SensorModel, off_reflection)
        In the order of the ends, two per sensor; ``off_reflection`` is G_off / rho per switch.
    frequency_hz : float
        Carrier.
    group_period_s : float
    tracked : bool
        Follow every press over time (location constant, force a random walk) instead of inverting
        each group by itself.
    ratios : str
        What the R are: ``change``, ``step`` or ``square`` (see ``estimation.estimators``).

    Attributes
    ----------
    counts : GroupCounts
        Of the readings given so far.
    """

    def __init__(self, sensors, frequency_hz, group_period_s, tracked=False, ratios="change"):
        self._period = group_period_s
        self._unfolder = RatioUnfolder(ratios, 2 * len(sensors))
        self._sensors = [
            _SensorReadout(name, model, frequency_hz, off, group_period_s, tracked)
            for name, model, off in sensors
        ]
        self._names = [name for name, _, _ in sensors]
        self._waiting = None
        self._before = None
        self._next = 0
        self.counts = GroupCounts()

    def process(self, state, ratios):
        """Takes the ratios R (2S,) of one group; gives the readings that are ready, in order."""
        if state.new_reference:
            self._unfolder.tare()
            for sensor in self._sensors:
                sensor.tare()
        state, ratios = self._unfolder.process(state, ratios)
        ready = self._fill(state.group)
        time_s = (state.group + 0.5) * self._period
        fields = []
        for i, sensor in enumerate(self._sensors):
            ends = slice(2 * i, 2 * i + 2)
            fields.append(sensor.read(time_s, ratios[ends], state, ends, state.clocks[i]))
        arrived = _Held(state.group, fields, np.abs(ratios), state.std_deg)
        ready = self._release(arrived) + ready
        self._before, self._waiting = self._waiting, arrived
        self._next = state.group + 1
        return ready

    def flush(self):
        """Gives the last group's readings."""
        ready = self._release(None)
        self._before, self._waiting = None, None
        return ready

    def _fill(self, group):
        """Rows for groups of which nothing was received."""
        first = self._next
        self.counts.dropped += max(0, group - first)
        if group - first > _LONGEST_GAP_S / self._period:
            return []
        return [
            Reading((absent + 0.5) * self._period, name, flags=("gap",))
            for absent in range(first, group)
            for name in self._names
        ]

    def _release(self, after):
        held = self._waiting
        if held is None:
            return []
        neighbours = [
            other
            for other in (self._before, after)
            if other is not None and abs(other.group - held.group) == 1
        ]
        sensors = range(len(held.fields))
        changed = [_changed_inside(i, held, neighbours) for i in sensors]
        if any(changed) or any(_touch_changes(i, held, neighbours) for i in sensors):
            # One sensor's change disturbs what is read of the others.
            changed = [c or _disturbed(i, held, neighbours) for i, c in enumerate(changed)]
        readings = []
        for fields, doubtful in zip(held.fields, changed, strict=True):
            if doubtful and "touch" in fields:
                fields["flags"].append("transition")
            readings.append(Reading(**{**fields, "flags": tuple(fields["flags"])}))
        self.counts.note(readings)
        return readings


class _Held:
    """A group that waits for its neighbour."""

    __slots__ = ("group", "fields", "levels", "std_deg")

    def __init__(self, group, fields, levels, std_deg):
        self.group = group
        self.fields = fields
        self.levels = levels
        self.std_deg = std_deg


def _changed_inside(sensor, held, neighbours):
    """Whether the press changed inside a group: |R| dips, or touch begins or ends beside it."""
    ends = slice(2 * sensor, 2 * sensor + 2)
    known = [n for n in neighbours if n.fields[sensor].get("touch") is not None]
    touch = held.fields[sensor].get("touch")
    if touch is None or not known:
        return False
    if touch == 1 and any(n.fields[sensor]["touch"] != touch for n in known):
        return True
    levels = np.min([n.levels[ends] for n in known], axis=0)
    noise = np.radians(held.std_deg[ends]) * levels
    dip = levels - held.levels[ends]
    return bool(np.any((held.levels[ends] < _DIP * levels) & (dip > 3.5 * noise)))


def _touch_changes(sensor, held, neighbours):
    """Whether touch begins or ends between a group and a neighbour."""
    touches = {n.fields[sensor].get("touch") for n in (held, *neighbours)}
    return {0, 1} <= touches


def _disturbed(sensor, held, neighbours):
    """Whether a group is much less certain than one of its neighbours."""
    ends = slice(2 * sensor, 2 * sensor + 2)
    return any(np.any(held.std_deg[ends] > _DISTURBED * n.std_deg[ends]) for n in neighbours)
