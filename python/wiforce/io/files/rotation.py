# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings that are renamed and begun anew after some time or at some size."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from ...errors import InputError, OutputError
from ..readings import Reading
from ..text.textfile import check_output
from .parquet import ParquetWriter
from .writers import ReadingsWriter, open_writer

_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400}
_BYTES = {"kB": 1000, "MB": 10**6, "GB": 10**9}
_LIMIT = re.compile(rf"([1-9][0-9]{{0,8}})({'|'.join([*_SECONDS, *_BYTES])})")


@dataclass(frozen=True)
class Rotation:
    """When a file of readings is renamed, and how many renamed files are kept.

    Attributes
    ----------
    every_s : int or None
        At whole multiples of so many seconds, counted from midnight UTC of 1970-01-01.
    size_bytes : int or None
        Once the file has reached this size.
    keep : int or None
        Number of renamed files that are kept; None keeps all.
    """

    every_s: int | None = None
    size_bytes: int | None = None
    keep: int | None = None

    @classmethod
    def of(
        cls, limits: Iterable[str], keep: int | None = None, option: str = "--rotate"
    ) -> Rotation:
        """A rotation from texts like ``15min``, ``6h``, ``1d``, ``500kB``, ``100MB``.

        Parameters
        ----------
        limits : iterable of str
            At most one of time and one of size.
        option : str
            Name of the option, for messages.

        Raises
        ------
        InputError
            For other texts, two of a kind, and files to be kept without a limit.
        """
        every_s = size_bytes = None
        for text in limits:
            match = _LIMIT.fullmatch(text)
            if match is None:
                rule = (
                    "must be a time in s, min, h or d, or a size in kB, MB or GB, like 6h or 100MB"
                )
                raise InputError(option, rule, text)
            number, unit = int(match[1]), match[2]
            if (unit in _SECONDS and every_s) or (unit in _BYTES and size_bytes):
                raise InputError(option, "may be given once for time and once for size", text)
            if unit in _SECONDS:
                every_s = number * _SECONDS[unit]
            else:
                size_bytes = number * _BYTES[unit]
        if keep is not None and every_s is None and size_bytes is None:
            raise InputError("--keep", f"needs {option}", keep)
        return cls(every_s, size_bytes, keep)

    def __bool__(self) -> bool:
        return self.every_s is not None or self.size_bytes is not None


class RotatingWriter:
    """Writes readings to a file that is renamed and begun anew; rows of a group stay together.

    ``OUT.csv`` becomes ``OUT-20260131T235959.964Z.csv``, by the time of its last row. A run
    continues the file that the previous one left.

    Parameters
    ----------
    inputs : iterable of str or Path, optional
        Files that the readings are made from, none of which may be written to.
    also : sequence of str
        Columns that follow those of a reading, and that each ``write`` is given.
    now : callable
        Unix time in seconds.

    Raises
    ------
    InputError
        When the path, or its folder, cannot be written to, or the path is an input.
    """

    def __init__(
        self,
        path: str | Path,
        rotation: Rotation,
        inputs: Iterable[str | Path] = (),
        also: Sequence[str] = (),
        now: Callable[[], float] = time.time,
    ) -> None:
        self._path, self._rotation, self._now = Path(path), rotation, now
        self._also = also
        check_output(path, inputs)
        if self._path.exists() and not self._path.is_file():
            raise InputError("--rotate", "needs a regular file as output", str(path))
        if not os.access(self._path.absolute().parent, os.W_OK):
            raise InputError(path, "its folder must be writable, for files that are renamed")
        self._writer = self._open()
        self._last_s: float | None = None
        self._renamed_ms = 0
        self._period = self._period_of(now())
        self._begun = False

    def __enter__(self) -> RotatingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, traceback)

    def begin(self) -> RotatingWriter:
        """Continue the file, or begin another when its time is over.

        Returns RotatingWriter: itself.

        Raises
        ------
        InputError, OutputError
            As :meth:`ReadingsWriter.begin`.
        """
        if not self._begun:
            self._begun = True
            if self._path.exists() and self._path.stat().st_size:
                written_s = self._path.stat().st_mtime
                if self._period_of(written_s) != self._period:
                    self._rename()
            self._writer.begin()
        return self

    def write(self, reading: Reading, more: Mapping[str, Any] | None = None) -> None:
        """Write one reading.

        Parameters
        ----------
        more : mapping of str to plain values, optional
            Of the columns that follow those of a reading.

        Raises
        ------
        OutputError
            When it cannot be written, or the file cannot be renamed.
        """
        self.begin()
        if reading.time_s != self._last_s and self._last_s is not None and self._is_due():
            self._writer.close()
            self._rename()
            self._writer = self._open().begin()
        self._last_s = reading.time_s
        self._writer.write(reading, more)

    def close(self) -> None:
        """Close the file."""
        self._writer.close()

    def _open(self) -> ReadingsWriter | ParquetWriter:
        return open_writer(self._path, also=self._also, append=True)

    def _period_of(self, time_s: float) -> int:
        return int(time_s // self._rotation.every_s) if self._rotation.every_s else 0

    def _is_due(self) -> bool:
        period, self._period = self._period, self._period_of(self._now())
        size = self._rotation.size_bytes
        return period != self._period or (size is not None and self._writer.size_bytes >= size)

    def _rename(self) -> None:
        try:
            # Names must rise, also when files are small or the clock is set back.
            ended_ms = max(self._path.stat().st_mtime_ns // 10**6, self._renamed_ms + 1)
            while (target := self._target(ended_ms)).exists():
                ended_ms += 1
            self._path.rename(target)
            self._renamed_ms = ended_ms
            self._delete_old()
        except OSError as error:
            rule = f"cannot be renamed ({error.strerror}); all rows until then are kept"
            raise OutputError(self._path, rule) from error

    def _target(self, ended_ms: int) -> Path:
        ended = time.strftime("%Y%m%dT%H%M%S", time.gmtime(ended_ms // 1000))
        name = f"{self._path.stem}-{ended}.{ended_ms % 1000:03d}Z{self._path.suffix}"
        return self._path.with_name(name)

    def _delete_old(self) -> None:
        if self._rotation.keep is None:
            return
        name = re.compile(
            rf"{re.escape(self._path.stem)}-\d{{8}}T\d{{6}}\.\d{{3}}Z{re.escape(self._path.suffix)}"
        )
        folder = self._path.absolute().parent
        renamed = sorted(path for path in folder.iterdir() if name.fullmatch(path.name))
        for path in renamed[: -self._rotation.keep]:
            path.unlink(missing_ok=True)


def open_rotating(
    path: str | Path | None,
    rotation: Rotation,
    inputs: Iterable[str | Path] = (),
    also: Sequence[str] = (),
    append: bool = False,
    metadata: Mapping[str, str] | None = None,
) -> ReadingsWriter | ParquetWriter | RotatingWriter:
    """A writer of readings, which renames its file where that is wanted.

    Parameters
    ----------
    path : str or Path, optional
        As for :func:`open_writer`.
    inputs, also, metadata
        As for :func:`open_writer`.
    append : bool
        Continue an existing file; a file that is renamed is always continued.

    Raises
    ------
    InputError
        As :func:`open_writer`, and where standard output is to be renamed or appended to.
    """
    if append and path is None:
        raise InputError("--append", "needs a file as output: -o OUT.csv or OUT.jsonl")
    if not rotation:
        return open_writer(path, inputs, also, append, metadata)
    if path is None:
        raise InputError("--rotate", "needs a file as output: -o OUT.csv or OUT.jsonl")
    return RotatingWriter(path, rotation, inputs, also)
