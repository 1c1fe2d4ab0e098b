# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch, force, location and flags of one sensor from its ratios R."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..io.readings import ESTIMATES, WEAK_FORCE_N, WEAK_PHASE_DEG, Flag, flag_bits
from .antennas import curvature_deg
from .average import phase_std_deg
from .gain_step import GainStep
from .groups import Array, Groups
from .motion import TouchedMotion
from .near_path import NearPath
from .off_state import corrected_phase_deg
from .press_evidence import PressEvidence, Suspicion
from .stage_flags import has_phases, stage_flags
from .touch import FORCED, TouchDetector

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

# Why nothing is known of the untouched phases until a tare.
RETUNED = "the device was opened or tuned again"
_NAN = math.nan
# Phase std above which a disturbance of the tag's own lines is flagged: most of it may be hidden.
_DISTURBED_DEG = 1.0
# The survey measures noise between the lines, the SNR of a reading includes what is left on them.
# It is up to 4 dB less in rooms that are read correctly, and 16 to 32 dB less beside a second tag
# on nearly the same clock where no other flag shows it (tests/rooms).
_LEFT_ON_LINES_DB = 15.0
# Flags of an inversion that finds no calibrated press.
_UNEXPLAINED = (Flag.INCONSISTENT | Flag.EXTRAPOLATED).value


class SensorState(NamedTuple):
    """What a sensor showed in the last group.

    Attributes
    ----------
    received : bool
        Whether the group could be read.
    touch : int
        Decision of the last group that could be read.
    moved : bool
        Whether the tag moved in the group.
    ratios : ndarray of complex, shape (2,)
        R of both ends against the untouched sensor, without the drift that the tare follows.
    force_n, location_mm : float
        NaN when unknown.
    reference_problem : str
        Why it is not known which phases are those of the untouched sensor; empty if they are.
    retuned : bool
        The oscillators have had new phases since the reference, which says nothing any more.

    Examples
    --------
    >>> SensorState(True, 0, False, np.ones(2), np.nan, np.nan, "").touch
    0
    """

    received: bool
    touch: int
    moved: bool
    ratios: Array
    force_n: float
    location_mm: float
    reference_problem: str
    retuned: bool = False


_UNSEEN = SensorState(False, 0, False, np.ones(2, complex), _NAN, _NAN, "")


class SensorReadout:
    """Decides touch, corrects for the off state of the switches and inverts the phases.

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
    tracked : bool
        Follow every press over time (location constant, force a random walk) instead of inverting
        each group by itself.
    drift_deg_per_sqrt_s : float, optional
        Stated random walk of the untouched phases; learned when not given.
    surveyed_snr_db : float, optional
        SNR of line 1 of the tag against the noise between the lines.
    tag_ratio : float
        Amplitude of the tag over that of the static path, for two antennas; 0 for one.
    in_lamps : bool
        Whether strong lines of the tag coincide with those of lamps.

    Attributes
    ----------
    state : SensorState
        Of the last group.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> model = wiforce.load_sensor("line-900mhz")
    >>> change = np.radians(model.phases_deg(4.0, 45.0) - model.untouched_deg())
    >>> none = np.zeros((1, 2), bool)
    >>> groups = Groups(
    ...     [20], ratios=np.exp(1j * change)[None], phase_std_deg=np.full((1, 2), 0.1),
    ...     locked=np.ones((1, 1), bool), overlapping=np.zeros((1, 1), bool),
    ...     new_reference=np.zeros(1, bool), in_reference=none, late_reference=none, reshaped=none)
    >>> found = SensorReadout(model, 900e6, 0j, 0.036).read(groups, sensor=0)
    >>> found["touch"].tolist(), found["force_n"].round(1).tolist()
    ([1], [4.0])
    """

    def __init__(
        self,
        model: SensorModel,
        frequency_hz: float,
        off_reflection: ArrayLike,
        group_period_s: float,
        tracked: bool = False,
        drift_deg_per_sqrt_s: float | None = None,
        surveyed_snr_db: float | None = None,
        tag_ratio: float = 0.0,
        in_lamps: bool = False,
    ) -> None:
        self._model = model
        self._frequency_hz = frequency_hz
        self._surveyed_snr_db, self._tag_ratio = surveyed_snr_db, tag_ratio
        self._in_lamps = in_lamps
        self._period_s = group_period_s
        self._off = np.asarray(off_reflection, complex)
        self._untouched = np.array(model.untouched_deg(frequency_hz))
        self._touch = TouchDetector(self._image(), group_period_s, drift_deg_per_sqrt_s)
        self._near_path = NearPath(group_period_s)
        self._motion = TouchedMotion()
        self._gain_step = GainStep(group_period_s)
        self._evidence = PressEvidence(model, frequency_hz, self._off, group_period_s)
        self._retuned = False
        self._scale, self._former_scale = np.ones(2), np.ones(2)
        self._tared = self._measured = 0
        self._forced: Array | None = None
        self._seen = False
        self.state = _UNSEEN
        self._tracker = model.tracker(group_period_s, frequency_hz) if tracked else None
        model.inverter(frequency_hz)  # tabulates the model before samples arrive

    def read(self, groups: Groups, sensor: int) -> dict[str, Array]:
        """Touch, phases, force, location and flags of one sensor in a batch.

        Parameters
        ----------
        groups : Groups
            With ``ratios``, ``phase_std_deg`` and the arrays of separation and reference.
        sensor : int
            Index of the sensor.

        Returns
        -------
        dict of str to ndarray, shape (G,) or (G, 2)
            By the names of the arrays in Groups; all flags except ``transition``.
        """
        ends = slice(2 * sensor, 2 * sensor + 2)
        ratios, std = groups.ratios[:, ends], groups.phase_std_deg[:, ends]
        renewed = self._renewals(groups, sensor)
        flags, readable = self._known_flags(groups, sensor, renewed)
        touch, drift, drifting, scale, moved = self._decide_touch(
            groups, renewed, ratios, std, flags, readable, sensor
        )
        if groups.group_variance is not None:
            of_group = phase_std_deg(ratios, groups.group_variance[:, ends])
            stepped = self._gain_step.process(renewed, touch, ratios, of_group)
            flags[stepped] |= Flag.MOVED.value
        near = self._near_path.process(groups.index, renewed, touch, ratios, std)
        touched = np.flatnonzero(touch == 1)
        if touched.size:
            std = np.hypot(np.hypot(std, drifting), near[:, None])
        if self._tag_ratio:
            std = np.hypot(std, curvature_deg(ratios, self._tag_ratio))
        if groups.common_std_deg.any():
            # What both ends have in common moves the force by twice the variance of what they have
            # independently.
            std = np.hypot(std, np.sqrt(2) * groups.common_std_deg[:, None])
        level = ratios * scale * np.exp(-1j * np.radians(drift))
        with np.errstate(invalid="ignore"):
            phases, slope = corrected_phase_deg(level, self._untouched, self._off)
            std = std * slope
        larger = std.max(axis=1)
        unsure = self._is_disturbed(groups, sensor) & (larger > _DISTURBED_DEG)
        flags[readable & unsure] |= Flag.INCONSISTENT.value
        flags[readable & (larger > WEAK_PHASE_DEG)] |= Flag.WEAK.value
        values, clear = np.full((len(groups), 4), _NAN), (flags == 0) & (near == 0)
        if self._tracker is not None:
            self._track(phases, std, touch, readable, values, flags)
        elif touched.size:
            values[touched], of_inversion = self._invert(phases[touched], std[touched])
            flags[touched] |= of_inversion
        unexplained = (flags & _UNEXPLAINED) != 0
        contradicting = self._evidence.take(renewed, level, phases, std, touch, clear, unexplained)
        flags[contradicting] |= Flag.INCONSISTENT.value
        if touched.size:
            flags[touched[~(values[touched, 1] <= WEAK_FORCE_N)]] |= Flag.WEAK.value
        self._watch_motion(phases, std, touch, readable, values, flags)
        phases[~readable] = _NAN
        self._seen |= bool(readable.any())
        if len(groups):
            self.state = SensorState(
                bool(readable[-1]),
                self._touch.touch,
                bool(moved[-1]),
                level[-1],
                float(values[-1, 0]),
                float(values[-1, 2]),
                self._touch.reference_problem,
                self._retuned,
            )
        return {
            "touch": touch,
            "phases_deg": phases,
            "psi_std_deg": std,
            "flags": flags,
            **dict(zip(ESTIMATES, values.T, strict=True)),
        }

    def _is_disturbed(self, groups: Groups, sensor: int) -> Array:
        """Whether something is received on the tag's own lines that is no noise; shape (G,)."""
        disturbed = np.full(len(groups), self._in_lamps)
        if groups.disturbed is not None:
            disturbed |= groups.disturbed[:, sensor]
        if self._surveyed_snr_db is not None and groups.snr_db is not None:
            snr_db = groups.snr_db[:, 2 * sensor : 2 * sensor + 2].min(axis=1)
            disturbed |= snr_db < self._surveyed_snr_db - _LEFT_ON_LINES_DB
        return disturbed

    @property
    def suspicions(self) -> list[Suspicion]:
        """Mistakes that the presses since the last tare suggest."""
        return self._evidence.suspicions

    @property
    def seen(self) -> bool:
        """Whether the sensor could be read in any group."""
        return self._seen

    def force_reference(self, former: Array | None) -> None:
        """Take the next reference although the sensor may be touched in it.

        Parameters
        ----------
        former : ndarray of complex, shape (2,), or None
            R of the new reference against the untouched sensor before; None when unknown.
        """
        self._forced = np.full(2, np.nan) if former is None else former
        self.state = self.state._replace(reference_problem=FORCED)

    def _image(self) -> Array:
        """Changes of arg R that a touch can cause; shape (n, 2).

        Up to 1.3 times the calibrated force, so that harder presses count as touches as well.
        """
        top = 1.3 * self._model.force_span_n[1]
        forces = np.geomspace(max(self._model.onset_force_n, 0.05), top, 30)
        locations = np.arange(0.0, self._model.length_mm + 0.5)
        grid = np.stack(np.meshgrid(forces, locations), -1).reshape(-1, 2)
        phases = self._model.phases_deg(grid[:, 0], grid[:, 1], self._frequency_hz)
        reflections = np.exp(1j * np.radians(phases))
        untouched = np.exp(1j * np.radians(self._untouched))
        return np.degrees(np.angle((reflections - self._off) / (untouched - self._off)))

    def _known_flags(self, groups: Groups, sensor: int, renewed: Array) -> tuple[Array, Array]:
        """Flags of each group from the stages before, and whether it can be read; shape (G,)."""
        # A retuned oscillator has a new phase, which rotates both ends until a new reference.
        flags, readable = stage_flags(groups, sensor), has_phases(groups, sensor)
        if self._retuned or groups.retuned.any():
            retuned = np.full(len(groups), self._retuned)
            for row in np.flatnonzero(groups.retuned | renewed):
                self._retuned = bool(groups.retuned[row]) or (self._retuned and not renewed[row])
                retuned[row:] = self._retuned
            flags[retuned] |= Flag.MOVED.value
        if not readable.all():
            unexplained = ~readable & ~groups.overlapping[:, sensor]
            unexplained &= (flags & ~Flag.INCONSISTENT.value) == 0
            flags[unexplained] |= Flag.WEAK.value
        return flags, readable

    def _decide_touch(
        self,
        groups: Groups,
        renewed: Array,
        ratios: Array,
        std: Array,
        flags: Array,
        readable: Array,
        sensor: int,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Touch (G,), -1 where it is unknown; drift that the tare subtracts, its standard
        deviation and the factor that R lacks, (G, 2) each; and whether the tag moved (G,).
        """
        touch, drift = np.full(len(groups), -1), np.zeros((len(groups), 2))
        drifting, scale = np.zeros((len(groups), 2)), np.ones((len(groups), 2))
        moved = np.zeros(len(groups), bool)
        times_s = ((groups.index + 0.5) * self._period_s).tolist()
        changes = np.degrees(np.arctan2(ratios.imag, ratios.real)).tolist()
        stds = std.tolist()
        ends = slice(2 * sensor, 2 * sensor + 2)
        in_reference = groups.in_reference[:, ends].any(axis=1).tolist()
        for row, restarts in enumerate(renewed.tolist()):
            if restarts:
                self._restart()
            if not readable[row]:
                scale[row] = self._scale
                continue
            decision = self._touch.update(times_s[row], changes[row], stds[row], in_reference[row])
            touch[row], drift[row] = decision.touch, decision.drift_deg
            if decision.touch:
                drifting[row] = self._touch.drift_std_deg(times_s[row])
            if decision.released:
                self._scale = self._former_scale
            scale[row], moved[row] = self._scale, decision.moved
            if decision.moved:
                flags[row] |= Flag.MOVED.value
            if decision.disturbed:
                flags[row] |= Flag.INCONSISTENT.value
        return touch, drift, drifting, scale, moved

    def _renewals(self, groups: Groups, sensor: int) -> Array:
        """Whether the sensor has a new reference from each group on, (G,).

        It keeps the former one where it was not received in any group of a tare.
        """
        renewed = groups.new_reference
        if not (renewed.any() or groups.in_tare.any()):
            return renewed
        renewed = renewed.copy()
        for row in np.flatnonzero(renewed | groups.in_tare):
            if renewed[row]:
                renewed[row] = not self._tared or self._measured > 0
                self._tared = self._measured = 0
            if groups.in_tare[row]:
                self._tared += 1
                self._measured += bool(groups.locked[row, sensor])
        return renewed

    def _restart(self) -> None:
        """Begin with a new reference."""
        forced, self._forced = self._forced, None
        self._scale, self._former_scale, unverified = np.ones(2), np.ones(2), None
        if forced is not None:
            untouched = None
            if np.isfinite(forced).all():
                self._former_scale = np.abs(forced)
                first, second = (-np.degrees(np.angle(forced))).tolist()
                untouched = first, second
            unverified = self._touch.forced_reference(untouched)
        self._touch.tare(unverified)

    def _invert(self, phases: Array, std: Array) -> tuple[Array, Array]:
        """Force, its std, location, its std (n, 4), and flags (n,) of touched groups."""
        found = self._model.invert(phases, std, frequency_hz=self._frequency_hz)
        values = np.column_stack([getattr(found, name) for name in ESTIMATES])
        values[~np.isfinite(values)] = _NAN
        return values, np.array([flag_bits(words) for words in found.flags])

    def _track(
        self, phases: Array, std: Array, touch: Array, readable: Array, values: Array, flags: Array
    ) -> None:
        assert self._tracker is not None
        for row in np.flatnonzero(readable):
            touched = touch[row] == 1
            *found, words = self._tracker.update(phases[row], std[row], touched)
            if touched:
                values[row] = [value if math.isfinite(value) else _NAN for value in found]
                flags[row] |= flag_bits(words)

    def _watch_motion(
        self, phases: Array, std: Array, touch: Array, readable: Array, values: Array, flags: Array
    ) -> None:
        touches = touch.tolist()
        for row in np.flatnonzero(readable).tolist():
            if touches[row] != 1:
                self._motion.forget()
                continue
            location_mm, spread_mm = values[row, 2:].tolist()
            if math.isnan(location_mm):
                continue
            spread_mm = 0.0 if math.isnan(spread_mm) else spread_mm
            if self._motion.update(phases[row].tolist(), std[row].tolist(), location_mm, spread_mm):
                flags[row] |= Flag.MOVED.value
