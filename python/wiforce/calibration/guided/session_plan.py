# SPDX-License-Identifier: GPL-3.0-or-later
"""What a guided calibration is to measure, and how much of it is done."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...sensor.model import MAX_FORCE_N
from ..checks import LEAST_FORCES

DEFAULT_LOCATIONS_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
DEFAULT_FORCES_N = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0)
# Half a division of a ruler with millimetres, on either side: 1 mm / sqrt(12).
RULER_STD_MM = 0.3
# Forces below half of the lowest or far above the highest planned one are errors of entry.
_LOW_PART, _HIGH_PART = 0.5, 1.25


@dataclass(frozen=True)
class SessionPlan:
    """What a guided calibration is to measure.

    ``sensor``: name of the sensor in the scene; ``location_mm``: locations from port 1, in the
    order of measurement; ``force_n``: forces at each location, rising; ``sweeps``: runs over the
    forces at each location; every second one falls.
    """

    sensor: str
    frequency_hz: float
    location_mm: tuple[float, ...] = DEFAULT_LOCATIONS_MM
    force_n: tuple[float, ...] = DEFAULT_FORCES_N
    sweeps: int = 1
    length_mm: float = 80.0
    permittivity: float = 1.0

    def __post_init__(self) -> None:
        locations, forces = self.location_mm, self.force_n
        if len(locations) < 2 or len(set(locations)) < len(locations):
            raise InputError("location_mm", "must be two or more different ones", locations)
        for location in locations:
            if not 0 < location < self.length_mm:
                rule = f"must lie within the line, 0 to {self.length_mm:g} mm"
                raise InputError("location_mm", rule, location)
        if len(forces) < LEAST_FORCES or any(np.diff(forces) <= 0):
            raise InputError("force_n", f"must be at least {LEAST_FORCES} forces, rising", forces)
        if not 0 < forces[0] < forces[-1] <= MAX_FORCE_N:
            raise InputError("force_n", f"must lie within 0 to {MAX_FORCE_N:g} N", forces)
        if self.sweeps < 1:
            raise InputError("sweeps", "must be 1 or more", self.sweeps)

    @property
    def force_limits_n(self) -> tuple[float, float]:
        """Smallest and largest force that is accepted."""
        return _LOW_PART * self.force_n[0], _HIGH_PART * self.force_n[-1]

    def targets(self) -> "list[Target]":
        """All measurements, in their order."""
        return [
            Target(location, sweep, force)
            for location in self.location_mm
            for sweep in range(1, self.sweeps + 1)
            for force in (self.force_n if sweep % 2 else self.force_n[::-1])
        ]

    def nearest_force(self, force_n: float) -> float:
        """The planned force that a measured one counts for, by their ratio."""
        return min(self.force_n, key=lambda planned: abs(np.log(planned / force_n)))


class Target(NamedTuple):
    """One measurement of a plan."""

    location_mm: float
    sweep: int
    force_n: float


class Coverage(NamedTuple):
    """Number of measurements by location and planned force.

    ``counts`` (locations, forces); ``wanted``: measurements that are planned for each.
    """

    location_mm: tuple[float, ...]
    force_n: tuple[float, ...]
    counts: np.ndarray
    wanted: int

    @property
    def done(self) -> tuple[int, int]:
        """Planned measurements that are taken, and all of them."""
        return int(np.minimum(self.counts, self.wanted).sum()), self.counts.size * self.wanted
