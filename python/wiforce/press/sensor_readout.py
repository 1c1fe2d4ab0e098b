# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch, force, location and flags of one sensor: the mean over all explanations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Array, Groups
from ..io.readings import ESTIMATES, WEAK_FORCE_N, WEAK_PHASE_DEG, Flag, flag_bits
from ..wiforce_kernels import press_reading
from .evidence import Suspicion
from .sensor_state import DOUBT, SensorState
from .stage_flags import has_phases, stage_flags

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

_NAN = math.nan
# The survey measures noise between the lines, the SNR of a reading includes what is left on them.
# It is up to 4 dB less in rooms that are read correctly, and 16 to 32 dB less beside a second tag
# on nearly the same clock where no other flag shows it (tests/rooms).
_LEFT_ON_LINES_DB = 15.0
# Flags of an inversion that finds no calibrated press.
_NO_PRESS = (Flag.INCONSISTENT | Flag.EXTRAPOLATED).value
# Flags of a reading, in the order of the kernel.
_FLAGS = (
    Flag.TRANSITION,
    Flag.WEAK,
    Flag.AMBIGUOUS,
    Flag.FORCE_UNOBSERVABLE,
    Flag.INCONSISTENT,
    Flag.EXTRAPOLATED,
    Flag.MOVED,
)


class SensorReading(NamedTuple):
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
        self._surveyed_snr_db, self._in_lamps = surveyed_snr_db, in_lamps
        self._period_s = group_period_s
        off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
        inverter = model.inverter(frequency_hz)
        self._reading = press_reading(
            inverter.posterior,
            np.radians(model.untouched_deg(frequency_hz)),
            off,
            off_std,
            tag_ratio,
            inverter.ruler_mm2,
            [flag.value for flag in _FLAGS],
            (WEAK_PHASE_DEG, WEAK_FORCE_N, DOUBT),
        )
        self.state = state
        # Force and location of the newest group that was touched; NaN when unknown.
        self.force_n = self.location_mm = _NAN
        self._tracker = model.tracker(group_period_s, frequency_hz) if tracked else None

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

    def read(self, groups: Groups, sensor: int, found: Array, flags: Array) -> SensorReading:
        """Read groups by their outcomes and the flags (G,) of the stages before."""
        touch, phases, std, values, flags, level, clear, odd = self._reading.read(
            found,
            has_phases(groups, sensor),
            groups.overlapping[:, sensor],
            self._is_disturbed(groups, sensor),
            groups.common_std_deg,
            flags,
            self._tracker is None,
        )
        touched = touch == 1
        if self._tracker is not None:
            self._track(phases, std, touch, values, flags)
            flags[touched & ~(values[:, 1] <= WEAK_FORCE_N)] |= Flag.WEAK.value
        if self.state.evidence is not None:
            no_press = (flags & _NO_PRESS) != 0
            against = self.state.evidence.take(level, phases, std, touch, clear, no_press, odd)
            flags[against] |= Flag.INCONSISTENT.value
        if touched.any():
            self.force_n, _, self.location_mm, _ = values[touched][-1].tolist()
        return SensorReading(touch, phases, std, values, flags)

    def _is_disturbed(self, groups: Groups, sensor: int) -> Array:
        """Whether something is received on the tag's own lines that is no noise; shape (G,)."""
        disturbed = np.full(len(groups), self._in_lamps)
        if groups.disturbed is not None:
            disturbed |= groups.disturbed[:, sensor]
        if self._surveyed_snr_db is not None and groups.snr_db is not None:
            snr_db = groups.snr_db[:, 2 * sensor : 2 * sensor + 2].min(axis=1)
            disturbed |= snr_db < self._surveyed_snr_db - _LEFT_ON_LINES_DB
        return disturbed

    def _track(self, phases: Array, std: Array, touch: Array, values: Array, flags: Array) -> None:
        assert self._tracker is not None
        for row, touched in enumerate(touch.tolist()):
            if touched < 0:
                continue
            *found, words = self._tracker.update(phases[row], std[row], touched == 1)
            if touched:
                values[row] = [value if math.isfinite(value) else _NAN for value in found]
                flags[row] |= flag_bits(words)


def as_arrays(readouts: list[SensorReading]) -> dict[str, Array]:
    """Arrays of :class:`Groups` from what the groups say of each sensor."""
    arrays = {
        name: np.array([getattr(each, name) for each in readouts]).swapaxes(0, 1)
        for name in ("touch", "phases_deg", "psi_std_deg", "flags")
    }
    values = np.array([each.values for each in readouts]).transpose(2, 1, 0)
    return arrays | dict(zip(ESTIMATES, values, strict=True))
