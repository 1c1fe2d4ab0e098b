# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings: the rows a reader gives, one per phase group and sensor, and their files."""

import csv
import json
import math
import sys
from dataclasses import asdict, dataclass

from .errors import InputError

FLAGS = (
    "reference",
    "gap",
    "transition",
    "weak",
    "ambiguous",
    "force-unobservable",
    "inconsistent",
    "extrapolated",
    "moved",
    "saturated",
)

# A reading is ``weak`` beyond these standard deviations of a phase and of the force.
WEAK_PHASE_DEG = 3.0
WEAK_FORCE_N = 1.5


@dataclass(frozen=True)
class Reading:
    """One sensor in one phase group.

    Attributes
    ----------
    time_s : float
        Centre of the group, from the capture's first sample.
    sensor : str
    touch : int or None
        1 when the line is shorted, 0 when not, None when it can't be told.
    force_n, force_std_n, location_mm, location_std_mm : float or None
        None when not touched.
    phase1_deg, phase2_deg : float or None
        psi_1 and psi_2 in (-180, 180].
    snr_db : float or None
        SNR of this group, of the weaker end, per subcarrier and snapshot.
    flags : tuple of str
        Of :data:`FLAGS`; empty when all is well.
    """

    time_s: float
    sensor: str
    touch: int | None = None
    force_n: float | None = None
    force_std_n: float | None = None
    location_mm: float | None = None
    location_std_mm: float | None = None
    phase1_deg: float | None = None
    phase2_deg: float | None = None
    snr_db: float | None = None
    flags: tuple = ()

    def row(self):
        """Values by column name, numbers rounded for print, what is unknown as None."""
        row = {
            key: _rounded(key, value) if isinstance(value, float) else value
            for key, value in asdict(self).items()
        }
        row["flags"] = " ".join(self.flags)
        return row


COLUMNS = tuple(Reading.__dataclass_fields__)
_DECIMALS = {"time_s": 6, "snr_db": 2}


def _rounded(key, value):
    return round(value, _DECIMALS.get(key, 4)) if math.isfinite(value) else None


class CsvWriter:
    """Writes readings as CSV with a header, flushed row by row."""

    def __init__(self, stream):
        self._stream = stream
        self._writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        self._writer.writeheader()

    def write(self, reading):
        self._writer.writerow({k: "" if v is None else v for k, v in reading.row().items()})
        self._stream.flush()

    def close(self):
        if self._stream is not sys.stdout:
            self._stream.close()


class JsonLinesWriter:
    """Writes readings as JSON lines, unknown values as null, flushed row by row."""

    def __init__(self, stream):
        self._stream = stream

    def write(self, reading):
        self._stream.write(json.dumps(reading.row(), allow_nan=False) + "\n")
        self._stream.flush()

    def close(self):
        if self._stream is not sys.stdout:
            self._stream.close()


def open_writer(path=None):
    """A writer of readings by the file's suffix: ``.csv``, or ``.jsonl`` for JSON lines.

    ``None`` writes CSV to standard output.

    Raises
    ------
    InputError
        For another suffix or a file that cannot be created.
    """
    if path is None:
        return CsvWriter(sys.stdout)
    kinds = {".csv": CsvWriter, ".jsonl": JsonLinesWriter}
    suffix = next((s for s in kinds if str(path).lower().endswith(s)), None)
    if suffix is None:
        raise InputError(path, "output must end in .csv or .jsonl")
    try:
        stream = open(path, "w", encoding="utf-8", newline="")
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})") from error
    return kinds[suffix](stream)
