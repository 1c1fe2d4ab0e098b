# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of readings, chosen by the name of the file, and outputs that begin a new file."""

from __future__ import annotations

import csv
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError, OutputError
from ..readings import COLUMNS, Reading
from ..text.textfile import check_output
from .formats import OUTPUTS, format_of, suffixes
from .output_file import OutputFile, ReadingsOutput
from .parquet import ParquetWriter

# The longest row that a run may have left incomplete when its machine failed.
_LONGEST_ROW = 65_536


class ReadingsWriter(ReadingsOutput):
    """Writes readings, a row each; what is written is in the file at once, in whole rows.

    The previous content of a file is kept until the first row is written, the writer is closed
    without one, or :meth:`begin` is called: a run that is refused or fails before that loses
    nothing. As a context manager it closes the file after success, and otherwise keeps what has
    been written. ``form`` makes a line of text from a reading's ``row()``; ``append`` keeps the
    previous content, which must have the same header. Standard output without a path.
    """

    def __init__(
        self,
        path: str | Path | None,
        form: Callable[[Mapping[str, Any]], str],
        header: str = "",
        inputs: Iterable[str | Path] = (),
        append: bool = False,
    ) -> None:
        self._path, self._form, self._append = path, form, append
        self._header, self._begun = header, False
        self._file: OutputFile | None = None
        if path is not None:
            check_output(path, inputs)
            if Path(path).exists() and not Path(path).is_file():
                # Opening a pipe loses nothing, and may have to wait for its reader.
                self.begin()

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write readings given as rows, all of them at once: all columns, in their order."""
        self.begin()
        lines = [self._form(row) for row in rows]
        self._put("".join(lines))
        self.rows += len(lines)

    def close(self) -> None:
        """Close the file; one without readings holds its header only."""
        self.begin()
        if self._file is not None:
            self._file.close()

    def begin(self) -> ReadingsWriter:
        """Empty the file except for its header, or prepare to append, unless that has been done.

        Refuses a file that another process is writing to, or whose columns are not those appended.
        """
        if self._begun:
            return self
        if self._path is not None:
            continued = self._append and Path(self._path).is_file()
            self._file = OutputFile(self._path, append=continued, lines=True)
            if continued:
                self._file.size_bytes = prepare_append(self._path, self._header)
        self._begun = True
        if not self.size_bytes:
            self._put(self._header)
        return self

    def _abandon(self) -> None:
        if self._file is not None:
            self._file.close()

    def _put(self, text: str) -> None:
        if self._file is None:
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            self._file.write(text.encode())


class _LineBuffer:
    """A file for ``csv.writer`` whose ``write`` returns the line, as ``writerow`` then does."""

    @staticmethod
    def write(line: str) -> str:
        return line


_csv_line = csv.writer(_LineBuffer, lineterminator="\n").writerow


def open_writer(
    path: str | Path | None = None,
    inputs: Iterable[str | Path] = (),
    also: Sequence[str] = (),
    append: bool = False,
    metadata: Mapping[str, str] | None = None,
) -> ReadingsWriter | ParquetWriter:
    """A writer of readings in the format that the file's suffix names.

    Parameters
    ----------
    path : str or Path, optional
        ``.csv``, ``.jsonl`` for JSON lines, or ``.parquet``; None writes CSV to standard output.
    inputs : iterable of str or Path, optional
        Files that the readings are made from, none of which may be written to.
    also : sequence of str
        Columns that follow those of a reading, and that each ``write`` is given.
    append : bool
        Keep the previous content of the file, and write no second header.
    metadata : mapping of str to str, optional
        What a Parquet file says of its readings; the other formats hold rows only.

    Returns
    -------
    ReadingsWriter or ParquetWriter

    Raises
    ------
    InputError
        For another suffix, a path that cannot be written to, an input, or a Parquet file without
        pyarrow or to be appended to.

    Examples
    --------
    >>> from gnuradio.wiforce.io.readings import Reading
    >>> with open_writer("press.csv") as writer:
    ...     writer.write(Reading(0.018, "arm", 1, 4.12345678, 0.05, 45.0, 0.1))
    >>> print(Path("press.csv").read_text().splitlines()[1])
    0.018,arm,1,4.1235,0.05,45.0,0.1,,,,,,
    """
    form = format_of(path)
    if path is not None and form not in OUTPUTS:
        raise InputError(path, f"output must end in {suffixes(OUTPUTS)} (MCAP: --mcap FILE)")
    if form is not None and form.suffix == ".jsonl":
        return ReadingsWriter(
            path,
            lambda row: json.dumps(row, allow_nan=False) + "\n",
            inputs=inputs,
            append=append,
        )
    if path is not None and form is not None and not form.text:
        if append:
            raise InputError(path, "nothing can be appended to Parquet; use .csv or .jsonl")
        return ParquetWriter(path, inputs, also, metadata)
    columns = (*COLUMNS, *also)
    return ReadingsWriter(
        path,
        lambda row: _csv_line(map(row.get, columns)),
        _csv_line(columns),
        inputs,
        append,
    )


def prepare_append(path: str | Path, header: str) -> int:
    """Size of a regular file that is appended to, once a last row that is incomplete was cut off.

    0 when it does not exist or is empty; refuses one that does not begin with ``header``.
    """
    if not Path(path).exists():
        return 0
    with open(path, "r+b") as file:
        first = file.readline(_LONGEST_ROW)
        if first and not _may_begin(first, header.encode()):
            rule = "must begin with the columns of these readings, or nothing can be appended"
            raise InputError(path, rule, first.decode("utf-8", "replace").strip())
        size = file.seek(0, os.SEEK_END)
        start = max(size - _LONGEST_ROW, 0)
        file.seek(start)
        end = file.read().rfind(b"\n") + 1
        whole = start + end if end else 0
        file.truncate(whole)
    return whole


def _may_begin(line: bytes, header: bytes) -> bool:
    """Whether a file of readings may begin with a line, which may be incomplete."""
    if not header:
        return line.startswith(b"{")
    return line == header if line.endswith(b"\n") else header.startswith(line)


_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400}
_BYTES = {"kB": 1000, "MB": 10**6, "GB": 10**9}
_LIMIT = re.compile(rf"([1-9][0-9]{{0,8}})({'|'.join([*_SECONDS, *_BYTES])})")


@dataclass(frozen=True)
class Rotation:
    """When a file of readings is renamed, and how many renamed files are kept."""

    every_s: int | None = None  # at whole multiples of it, counted from midnight UTC of 1970-01-01
    size_bytes: int | None = None  # once the file has reached this size
    keep: int | None = None  # renamed files that are kept; None keeps all

    @classmethod
    def of(
        cls, limits: Iterable[str], keep: int | None = None, option: str = "--rotate"
    ) -> Rotation:
        """A rotation from texts like ``15min``, ``6h``, ``1d``, ``500kB``, ``100MB``.

        At most one of time and one of size; ``keep`` needs one of them.
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

    def __exit__(self, *error: Any) -> None:
        self._writer.__exit__(*error)

    def begin(self) -> RotatingWriter:
        """Continue the file, or begin another when its time is over."""
        if not self._begun:
            self._begun = True
            if self._path.exists() and self._path.stat().st_size:
                written_s = self._path.stat().st_mtime
                if self._period_of(written_s) != self._period:
                    self._rename()
            self._writer.begin()
        return self

    def write(self, reading: Reading, more: Mapping[str, Any] | None = None) -> None:
        """As :meth:`ReadingsOutput.write`; OutputError also when the file cannot be renamed."""
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
    """A writer of readings as :func:`open_writer`, which renames its file where that is wanted.

    A file that is renamed is always continued; standard output cannot be.
    """
    if append and path is None:
        raise InputError("--append", "needs a file as output: -o OUT.csv or OUT.jsonl")
    if not rotation:
        return open_writer(path, inputs, also, append, metadata)
    if path is None:
        raise InputError("--rotate", "needs a file as output: -o OUT.csv or OUT.jsonl")
    return RotatingWriter(path, rotation, inputs, also)
