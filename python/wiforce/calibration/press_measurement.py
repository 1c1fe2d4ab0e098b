# SPDX-License-Identifier: GPL-3.0-or-later
"""One measurement of a guided calibration: the mean phases of a press that holds still."""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..io.readings import WEAK_PHASE_DEG, Reading
from ..sensor import line
from ..signal.carrier import wrap_deg

# Fewest phase groups of a measurement: halves of four give a drift and its error.
LEAST_GROUPS = 8
# The shorting points must hold still within this distance, half of the location error aimed at.
STEADY_MM = 0.25
# Standard errors by which the means of both halves differ, and standard deviations by which a
# single group differs from the median, by chance in less than 0.1 % of measurements of 14 groups.
_DRIFT_STDS, _JUMP_STDS = 5.0, 6.0
# The noise is estimated from the steps between neighbours without the two largest: a slip causes
# one of them, a single bad group two. For normal noise and n groups the estimate is low by the
# factor 1 + 5 / n.
_LEFT_OUT, _LOW_BY = 2, 5.0
# Flags of what is received. The others state how the scene's provisional model explains the
# phases, which is what the calibration is to replace.
_REFUSED = {
    "reference": "the untouched reference is being measured; release the sensor and wait",
    "gap": "samples were lost",
    "saturated": "the receiver is saturated; lower the gains until nothing is clipped",
    "moved": "the tag or an antenna moved; release the sensor and tare (t)",
    "transition": "the press changed",
}
_REFUSED_UNTOUCHED = {
    **_REFUSED,
    "inconsistent": "the untouched reference was disturbed; release the sensor and tare (t)",
    "weak": "the tag is received too weakly",
}


@dataclass(frozen=True)
class PressMeasurement:
    """Mean phases of a press, or of the untouched sensor, where location and force are NaN and 0.

    ``sweep`` is the run over the forces there, from 1; ``time_utc`` ISO 8601.
    """

    location_mm: float
    force_n: float
    force_std_n: float
    phase_deg: tuple[float, float]
    phase_std_deg: tuple[float, float]
    groups: int
    sweep: int = 1
    time_utc: str = field(
        default_factory=lambda: datetime.datetime.now(datetime.timezone.utc).isoformat(
            timespec="seconds"
        )
    )

    @property
    def untouched(self) -> bool:
        """Whether it is of the untouched sensor."""
        return math.isnan(self.location_mm)


def steady_deg(frequency_hz: float, permittivity: float = 1.0) -> float:
    """Largest change of a phase during a measurement, in degrees: that of 0.25 mm of line."""
    return STEADY_MM * line.round_trip_deg_per_mm(frequency_hz, permittivity)


def measure_untouched(readings: Sequence[Reading], largest_change_deg: float) -> PressMeasurement:
    """Mean phases of the untouched sensor, from consecutive readings of it."""
    mean, std = _phases(readings, "untouched sensor", 0, largest_change_deg, _REFUSED_UNTOUCHED)
    return PressMeasurement(math.nan, 0.0, math.nan, mean, std, len(readings))


def measure_press(
    readings: Sequence[Reading],
    location_mm: float,
    force_n: float,
    largest_change_deg: float,
    force_std_n: float = math.nan,
    sweep: int = 1,
) -> PressMeasurement:
    """Mean phases of a press that holds still, from consecutive readings of one sensor."""
    where = f"press at {location_mm:g} mm"
    mean, std = _phases(readings, where, 1, largest_change_deg, _REFUSED)
    return PressMeasurement(location_mm, force_n, force_std_n, mean, std, len(readings), sweep)


def _phases(
    readings: Sequence[Reading],
    where: str,
    touch: int,
    largest_change_deg: float,
    refused: dict[str, str],
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean phases and their standard deviations of readings that pass all checks."""
    if len(readings) < LEAST_GROUPS:
        rule = f"must have at least {LEAST_GROUPS} readings"
        raise InputError(where, rule, len(readings))
    missing = [r.touch is None or r.phase1_deg is None for r in readings]
    state, found = ("touched", "no touch") if touch else ("released", "a touch")
    rules = [
        (missing, "must be received; the tag was not in {}"),
        # A flag explains why the reader takes a press for none.
        *(
            (
                [word in r.flags for r in readings],
                f"must not be flagged; '{word}' in {{}}: {reason}",
            )
            for word, reason in refused.items()
        ),
        ([r.touch != touch for r in readings], f"must be {state}; {found} in {{}}"),
    ]
    for broken, rule in rules:
        if any(broken):
            share = f"{sum(broken)} of {len(readings)} readings"
            raise InputError(where, rule.format(share))
    phases = np.array([(r.phase1_deg, r.phase2_deg) for r in readings], float)
    centre = np.rad2deg(np.angle(np.mean(np.exp(1j * np.deg2rad(phases)), axis=0)))
    deviations = wrap_deg(phases - centre)
    for port, deviation in enumerate(deviations.T, 1):
        _check_steady(deviation, where, port, largest_change_deg)
    std = deviations.std(axis=0, ddof=1) / math.sqrt(len(readings))
    return (float(centre[0]), float(centre[1])), (float(std[0]), float(std[1]))


def _check_steady(deviation: np.ndarray, where: str, port: int, largest_deg: float) -> None:
    steps = np.sort(np.abs(np.diff(deviation)))[:-_LEFT_OUT]
    noise = float(np.sqrt(np.mean(steps**2) / 2)) * (1 + _LOW_BY / len(deviation))
    if noise > WEAK_PHASE_DEG:
        rule = f"must be received better; the phase of port {port} scatters by {noise:.1f} deg"
        raise InputError(where, rule)
    half = len(deviation) // 2
    drift = abs(float(np.mean(deviation[-half:]) - np.mean(deviation[:half])))
    allowed = largest_deg + _DRIFT_STDS * noise * math.sqrt(2 / half)
    jump = float(np.max(np.abs(deviation - np.median(deviation))))
    if drift > allowed or jump > largest_deg + _JUMP_STDS * noise:
        change = max(drift, jump)
        rule = (
            f"must hold still while it is measured; the phase of port {port} changed by "
            f"{change:.1f} deg ({largest_deg:.1f} allowed)"
        )
        raise InputError(where, rule)
