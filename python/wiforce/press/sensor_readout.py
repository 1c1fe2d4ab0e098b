# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch, force, location and flags of one sensor: the mean over explanations that count."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Array, Groups
from ..estimation.phases.off_state import corrected_phase_deg
from ..io.readings import (
    ESTIMATES,
    WEAK_FORCE_N,
    WEAK_PHASE_DEG,
    Flag,
    Reading,
    flag_bits,
    flag_words,
)
from ..wiforce_kernels import press_reading, sensor_groups
from .evidence import Suspicion
from .sensor_state import CLAIMED, DOUBT, SensorState

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

_NAN = math.nan
# What a group says of a sensor as arrays of :class:`Groups`.
ARRAYS = "touch", "phases_deg", "psi_std_deg", *ESTIMATES, "flags"
# The survey measures noise between the lines, the SNR of a reading includes what is left on them.
# It is up to 4 dB less in rooms that are read correctly, and 16 to 32 dB less beside a second tag
# on nearly the same clock where no other flag shows it (tests/rooms).
_LEFT_ON_LINES_DB = 15.0
_SATURATED = Flag.SATURATED.value
# Flags of the stages before, and those of a reading, in the order of the kernel.
_STAGE_FLAGS = Flag.REFERENCE, Flag.GAP, Flag.SATURATED, Flag.MOVED, Flag.INCONSISTENT
_FLAGS = (
    Flag.TRANSITION,
    Flag.WEAK,
    Flag.AMBIGUOUS,
    Flag.FORCE_UNOBSERVABLE,
    Flag.INCONSISTENT,
    Flag.EXTRAPOLATED,
    Flag.MOVED,
)


class SensorReadout:
    """Inverts the likeliest explanation of a group and all other presses, and gives their mean.

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
        self._period_s = group_period_s
        least_snr_db = -math.inf if surveyed_snr_db is None else surveyed_snr_db - _LEFT_ON_LINES_DB
        self._stages = _stages_of(group_period_s, least_snr_db, in_lamps)
        off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
        inverter = model.inverter(frequency_hz)
        self._reading = press_reading(
            inverter.posterior,
            np.radians(model.untouched_deg(frequency_hz)),
            off,
            off_std,
            state.shows_turns,
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

        Gives outcomes of the group before each of these, and what the stages before say of these,
        shape (G,).
        """
        rows, stages = self._stages.of(vars(groups), sensor, receiver)
        readable = stages["readable"].tolist()
        found, retuned = self.state.take(groups, sensor, self._period_s, rows, readable)
        if True in retuned:
            stages["flags"][retuned] |= Flag.MOVED.value
        return found, stages

    def read(self, found: Array, stages: Array, begin: int = 0) -> Array:
        """Read groups by their outcomes and what the stages before say of them, (G,); ``begin`` is
        the row, in ``found``, of the first group.

        Gives a structured array (G,): the fields of a reading, and what the evidence needs.
        """
        read = self._reading.read(found, stages, self._tracker is None, begin)
        clipped = [bool(flags & _SATURATED) for flags in read["flags"].tolist()]
        self.state.note_doubt(read["doubtful"].tolist(), clipped, self._period_s)
        if self._tracker is not None:
            self._track(read)
            weak = (read["touch"] == 1) & ~(read["force_std_n"] <= WEAK_FORCE_N)
            read["flags"][weak] |= Flag.WEAK.value
        if self.state.evidence is not None and True in (odd := self.state.evidence.take(read)):
            read["flags"][odd] |= Flag.INCONSISTENT.value
        if 1 in (touch := read["touch"].tolist()):
            newest = read[len(touch) - 1 - touch[::-1].index(1)]
            self.force_n, self.location_mm = float(newest["force_n"]), float(newest["location_mm"])
        return read

    def _track(self, read: Array) -> None:
        assert self._tracker is not None
        for row in read:
            if row["touch"] < 0:
                continue
            phases, std = row["phases_deg"], row["psi_std_deg"]
            *found, words = self._tracker.update(phases, std, row["touch"] == 1)
            if row["touch"]:
                for name, value in zip(ESTIMATES, found, strict=True):
                    row[name] = value if math.isfinite(value) else math.nan
                row["flags"] |= flag_bits(words)


def _stages_of(
    group_period_s: float, least_snr_db: float = -math.inf, in_lamps: bool = False
) -> sensor_groups:
    """What takes the arrays of a batch for a sensor: observations of its phases, flags, SNR.

    Something is received on the tag's own lines that is no noise where the SNR is less than
    ``least_snr_db``, and ``in_lamps``.
    """
    bits = [flag.value for flag in _STAGE_FLAGS]
    return sensor_groups(group_period_s, bits, CLAIMED, least_snr_db, in_lamps)


# Change of a phase by which the line is touched. The shorted line differs from the open one by much
# more at one end at least (docs/sensors.md), drift between two tares by much less.
_TOUCHED_DEG = 6.0


def uncalibrated_readings(
    groups: Groups,
    sensor: int,
    name: str,
    untouched_deg: ArrayLike,
    off_reflection: ArrayLike,
    group_period_s: float,
) -> list[Reading]:
    """Touch, phases and flags of one sensor, without force and location; one reading per group.

    The tag is known not to move, and the sensor not known yet. The reader tells a touch from a
    motion of the tag by the model of the sensor: a press in the middle of the line changes both
    phases alike, as a motion does. Before a sensor is calibrated there is no model to decide by. A
    tag that lies still, as during a calibration, needs none.

    ``untouched_deg`` is psi_10 and psi_20, ``off_reflection`` G_off / rho, per switch where they
    differ. Phases refer to the untouched reference alone: no drift is subtracted.
    """
    ends = slice(2 * sensor, 2 * sensor + 2)
    ratios = groups.ratios[:, ends]
    _, known = _stages_of(group_period_s).of(vars(groups), sensor, np.zeros((len(groups), 3)))
    with np.errstate(invalid="ignore"):
        phases, _ = corrected_phase_deg(ratios, untouched_deg, off_reflection)
    touched = np.abs(np.degrees(np.angle(ratios))).max(axis=1) > _TOUCHED_DEG
    readings = []
    for row, each in enumerate(known):
        found = (None, None, None)
        if each["readable"]:
            found = (int(touched[row]), *phases[row].tolist())
        readings.append(
            Reading(
                (int(each["group"]) + 0.5) * group_period_s,
                name,
                found[0],
                phase1_deg=found[1],
                phase2_deg=found[2],
                flags=flag_words(int(each["flags"])),
                group=int(each["group"]),
                interference=float(each["interference"]),
            )
        )
    return readings
