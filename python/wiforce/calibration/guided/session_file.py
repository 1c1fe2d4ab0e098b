# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan of a guided calibration, and the file that holds its measurements."""

import csv
import fcntl
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError, unwritable
from ...io.text.textfile import cell_number, check_output, read_csv
from ...sensor.model import MAX_FORCE_N
from ...signal.carrier import same_carrier
from ..data import LEAST_FORCES
from .press_measurement import PressMeasurement

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


COLUMNS = (
    "time_utc",
    "sensor",
    "freq_mhz",
    "location_mm",
    "force_n",
    "force_std_n",
    "phase1_deg",
    "phase2_deg",
    "phase1_std_deg",
    "phase2_std_deg",
    "groups",
    "press",
)


class SessionFile:
    """Appends measurements; each is on the disk before the next is taken.

    An existing file of the same sensor is continued. A last row that a crash or a full disk left
    without its end is removed. Only one process at a time has the file open.

    ``sensor``: name of the sensor, a column of the file; ``frequency_hz``: carrier, in Hz,
    likewise. ``measurements``: all rows of the file, in its order.
    """

    def __init__(self, path: str | Path, sensor: str, frequency_hz: float) -> None:
        check_output(path)
        self.path = Path(path)
        self._sensor, self._frequency_hz = sensor, frequency_hz
        self.measurements: list[PressMeasurement] = []
        self._ends: list[int] = []  # of the rows, in bytes
        try:
            self._file = open(path, "a+b", buffering=0)
        except OSError as error:
            raise unwritable(path, error) from error
        try:
            self._lock()
            self._restore()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "SessionFile":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; an empty one is removed."""
        if not self._file.closed and os.fstat(self._file.fileno()).st_size == 0:
            self.path.unlink(missing_ok=True)
        self._file.close()

    def append(self, measurement: PressMeasurement) -> None:
        """Store a measurement.

        Raises OutputError, InputError when it cannot be written; the rows before it are kept.
        """
        if not self._ends:
            self._write(",".join(COLUMNS) + "\n")
        row = io.StringIO()
        csv.writer(row, lineterminator="\n").writerow(self._row(measurement))
        self._write(row.getvalue())
        self.measurements.append(measurement)

    def remove_last(self) -> PressMeasurement | None:
        """Remove the last measurement.

        Returns PressMeasurement or None: the one that was removed; None when there is none.
        """
        if not self.measurements:
            return None
        self._ends.pop()
        self._file.truncate(self._ends[-1])
        return self.measurements.pop()

    def _row(self, measurement: PressMeasurement) -> list[object]:
        m = measurement
        return [
            m.time_utc,
            self._sensor,
            f"{self._frequency_hz / 1e6:.12g}",
            "" if m.untouched else f"{m.location_mm:.6g}",
            f"{m.force_n:.4f}",
            "" if math.isnan(m.force_std_n) else f"{m.force_std_n:.4f}",
            *(f"{phase:.4f}" for phase in m.phase_deg),
            *(f"{std:.4f}" for std in m.phase_std_deg),
            m.groups,
            "" if m.untouched else m.sweep,
        ]

    def _write(self, text: str) -> None:
        data = text.encode()
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:])
            os.fsync(self._file.fileno())
        except OSError as error:
            self._file.truncate(self._ends[-1] if self._ends else 0)
            raise unwritable(self.path, error) from error
        self._ends.append(os.fstat(self._file.fileno()).st_size)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(self.path, "is in use by another calibration") from None

    def _restore(self) -> None:
        """Read the rows of an existing file."""
        self._file.seek(0)
        data = self._file.read()
        if not data:
            return
        header = ",".join(COLUMNS)
        if b"\n" not in data and header.encode().startswith(data):
            self._file.truncate(0)
            return
        lines = data.splitlines(keepends=True)
        if lines[0].decode("utf-8", "replace").strip() != header:
            rule = "must be a new file, or one that `calibrate --live` has written"
            raise InputError(self.path, rule, lines[0][:60].decode("utf-8", "replace").strip())
        if not lines[-1].endswith(b"\n"):
            data = data[: -len(lines.pop())]
            self._file.truncate(len(data))
        if len(lines) > 1:
            _, rows = read_csv(self.path)
            self.measurements = [self._measurement(number, row) for number, row in rows]
        self._ends = [sum(map(len, lines[: i + 1])) for i in range(len(lines))]

    def _measurement(self, number: int, row: dict[str, str]) -> PressMeasurement:
        where = f"{self.path}: row {number}"
        if row["sensor"] != self._sensor:
            rule = f"must be of the sensor '{self._sensor}', whose calibration is continued"
            raise InputError(f"{where}: sensor", rule, row["sensor"])

        def number_of(key: str, empty: float | None = None) -> float:
            return cell_number(row, key, where, empty)

        if not same_carrier(1e6 * number_of("freq_mhz"), self._frequency_hz):
            rule = f"must be {self._frequency_hz / 1e6:g}, the scene's carrier"
            raise InputError(f"{where}: freq_mhz", rule, row["freq_mhz"])
        return PressMeasurement(
            location_mm=number_of("location_mm", math.nan),
            force_n=number_of("force_n"),
            force_std_n=number_of("force_std_n", math.nan),
            phase_deg=(number_of("phase1_deg"), number_of("phase2_deg")),
            phase_std_deg=(number_of("phase1_std_deg"), number_of("phase2_std_deg")),
            groups=int(number_of("groups")),
            sweep=int(number_of("press", 1)),
            time_utc=row["time_utc"],
        )
