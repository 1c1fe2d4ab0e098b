# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings: the rows a reader gives, one per phase group and sensor, and their files."""

import csv
import io
import json
import math
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from enum import IntFlag, auto
from functools import lru_cache
from pathlib import Path

from ..errors import InputError, OutputError
from .textfile import check_output


class Flag(IntFlag):
    """Why a reading is doubtful; its word is the member's name in lower case with hyphens."""

    REFERENCE = auto()
    GAP = auto()
    TRANSITION = auto()
    WEAK = auto()
    AMBIGUOUS = auto()
    FORCE_UNOBSERVABLE = auto()
    INCONSISTENT = auto()
    EXTRAPOLATED = auto()
    MOVED = auto()
    SATURATED = auto()

    @property
    def word(self):
        """The flag as files and messages spell it."""
        return self.name.lower().replace("_", "-")


FLAGS = tuple(flag.word for flag in Flag)
_BIT_OF = {flag.word: int(flag) for flag in Flag}


@lru_cache
def flag_words(bits):
    """Words of the flags in a sum of bits, in their order.

    Examples
    --------
    >>> flag_words(int(Flag.GAP | Flag.WEAK))
    ('gap', 'weak')
    """
    return tuple(flag.word for flag in Flag if flag & bits)


@lru_cache
def flag_bits(words):
    """The sum of bits of a tuple of words.

    Examples
    --------
    >>> flag_words(flag_bits(("weak", "gap")))
    ('gap', 'weak')
    """
    return sum(_BIT_OF[word] for word in words)


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


class GroupCounts:
    """How many phase groups came to which end; together all that the stream spans.

    Attributes
    ----------
    clear : int
        Groups of which no sensor has a flag.
    flagged : int
        Groups with a flag.
    dropped : int
        Groups of which nothing was received.
    flags : Counter
        Flagged groups by flag.
    """

    def __init__(self):
        self.clear = self.flagged = self.dropped = 0
        self.flags = Counter()

    def note(self, readings):
        """Count one group by its readings, one per sensor."""
        flags = {flag for reading in readings for flag in reading.flags}
        self.flags.update(flags)
        if flags:
            self.flagged += 1
        else:
            self.clear += 1

    @property
    def groups(self):
        return self.clear + self.flagged + self.dropped

    def asdict(self):
        return {key: getattr(self, key) for key in ("clear", "flagged", "dropped")}

    def short(self):
        """As ``str``, without the flags."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.asdict().items())
        return f"{self.groups} groups: {kinds}"

    def __str__(self):
        named = ", ".join(f"{self.flags[flag]} {flag}" for flag in FLAGS if self.flags[flag])
        return self.short().replace(" flagged", f" flagged ({named})" if named else " flagged")


class ReadingsWriter:
    """Writes readings a row each: what was written is in the file at once, and in whole rows.

    What a file held before is kept until the first row comes, or the writer is closed without one,
    or :meth:`begin` is called: whoever is refused or fails before that loses nothing. As a context
    it is closed when all went well, and else keeps what it has written.

    Parameters
    ----------
    path : str or Path, optional
        Standard output when not given.
    form : callable
        From a reading's ``row()`` to a line of text.
    header : str
        First line.
    """

    def __init__(self, path, form, header=""):
        self._path, self._form = path, form
        self._header, self._begun, self._file = header, False, None
        self._whole, self._refusal = 0, None
        if path is not None:
            check_output(path)
            if Path(path).exists() and not Path(path).is_file():
                # A pipe holds nothing that could be lost, and may have to be waited for.
                self.begin()

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        if kind is None:
            self.close()
        elif self._file is not None:
            self._file.close()

    def write(self, reading):
        """Write one reading.

        Raises
        ------
        OutputError
            When it cannot be written, as on a full disk; the file then ends with the row before,
            and takes no other.
        """
        self.begin()
        self._put(self._form(reading.row()))

    def close(self):
        self.begin()
        if self._file is not None:
            self._file.close()

    def begin(self):
        """Empties the file but for its header, unless it has begun; returns the writer.

        Raises
        ------
        InputError
            When the file cannot be opened.
        OutputError
            When it cannot be written to.
        """
        if self._begun:
            return self
        if self._path is not None:
            try:
                self._file = open(self._path, "wb", buffering=0)
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise InputError(self._path, f"cannot be written ({reason})") from error
        self._begun = True
        self._put(self._header)
        return self

    def _put(self, text):
        if self._path is None:
            sys.stdout.write(text)
            sys.stdout.flush()
            return
        if self._refusal is not None:
            raise self._refusal
        left = text.encode()
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._cut()
            rule = f"cannot be written further ({error.strerror}); all rows until then are kept"
            self._refusal = OutputError(self._path, rule)
            raise self._refusal from error
        self._whole += len(text.encode())

    def _cut(self):
        """Take back the part of a row that was still written."""
        try:
            self._file.truncate(self._whole)
        except OSError:
            pass  # no regular file


def _csv_line(cells):
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow("" if c is None else c for c in cells)
    return stream.getvalue()


def open_writer(path=None):
    """A writer of readings by the file's suffix: ``.csv``, or ``.jsonl`` for JSON lines.

    ``None`` writes CSV to standard output.

    Raises
    ------
    InputError
        For another suffix or a path that cannot be written to.
    """
    name = "" if path is None else str(path).lower()
    if name.endswith(".jsonl"):
        return ReadingsWriter(path, lambda row: json.dumps(row, allow_nan=False) + "\n")
    if path is not None and not name.endswith(".csv"):
        raise InputError(path, "output must end in .csv or .jsonl")
    return ReadingsWriter(path, lambda row: _csv_line(row.values()), _csv_line(COLUMNS))
