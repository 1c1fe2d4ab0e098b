# SPDX-License-Identifier: GPL-3.0-or-later
"""The file of a guided calibration: a table of taps, a row per measurement, kept as it grows."""

import csv
import fcntl
import io
import math
import os
from pathlib import Path
from types import TracebackType

from ...errors import InputError, unwritable
from ...io.text.textfile import check_output, read_csv
from ...signal.carrier import same_carrier
from .press_measurement import PressMeasurement

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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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
            text = (row[key] or "").strip()
            if not text and empty is not None:
                return empty
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InputError(f"{where}: {key}", "must be a finite number", text)
            return value

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
