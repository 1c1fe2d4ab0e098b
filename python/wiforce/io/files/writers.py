# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of readings, by the name of the file: text, also in files in turn, and Parquet."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from ...errors import InputError, OutputError
from ..optional import optional_modules
from ..outputs import Output
from ..readings import COLUMNS, NUMBERS, SURFACE_COLUMNS
from ..text.textfile import check_output
from . import OUTPUTS, format_of, suffixes
from .output_file import LONGEST_ROW, EndedOutput, OutputFile


def _csv_text(rows: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class ReadingsWriter(Output):
    """Writes readings, whole rows at once, to a file or, without a path, standard output.

    The previous content is kept until the first row, the end, or :meth:`begin`: a run that fails
    before loses nothing. Rows after the end continue the file. ``also`` are further columns.
    """

    rows = 0  # taken so far

    def __init__(
        self,
        path: str | Path | None,
        inputs: Iterable[str | Path] = (),
        also: Sequence[str] = (),
        append: bool = False,
    ) -> None:
        self._path, self._append, self._begun = path, append, False
        self._file: OutputFile | None = None
        form = format_of(path)
        self._json = form is not None and form.suffix == ".jsonl"
        self._columns = (*COLUMNS, *also)
        self._header = "" if self._json else _csv_text([self._columns])
        # Lines of JSON name their values: a press on a surface has more of them. What a live run
        # knows of a row besides its columns is not for files.
        self._named = dict.fromkeys((*COLUMNS, *SURFACE_COLUMNS, *also)) if also else None
        if path is not None:
            check_output(path, inputs)

    def __enter__(self) -> ReadingsWriter:
        if self._path is not None and Path(self._path).exists() and not Path(self._path).is_file():
            # Opening a pipe loses nothing, and may have to wait for its reader.
            self.begin()
        return self

    def begin(self) -> ReadingsWriter:
        """Empty the file except for its header, or prepare to append to one with that header."""
        if self._begun:
            return self
        size_bytes = 0
        if self._path is not None:
            continued = self._append and Path(self._path).is_file()
            self._file = OutputFile(self._path, append=continued, lines=True)
            if continued:
                size_bytes = whole_rows(self._path, self._header)
                self._file.cut(size_bytes)
        self._begun = self._append = True
        if not size_bytes:
            self._put(self._header)
        return self

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        if self._file is not None and self._file.closed:
            self._begun = False
        self.begin()
        rows = list(rows)
        self._put(self._text(rows))
        self.rows += len(rows)

    def close(self) -> None:
        """Close the file; one without readings holds its header only."""
        self.begin()
        self.abandon()

    def abandon(self) -> None:
        if self._file is not None:
            self._file.close()

    def _text(self, rows: Iterable[Mapping[str, Any]]) -> str:
        if not self._json:
            return _csv_text(map(row.get, self._columns) for row in rows)
        if (named := self._named) is not None:
            rows = ({name: row[name] for name in named if name in row} for row in rows)
        return "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows)

    def _put(self, text: str) -> None:
        if self._file is None:
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            self._file.write(text.encode())


# So many rows wait in memory, some 2 MB, and are written at once: 2.4 min of one sensor.
_GROUP_ROWS = 4096
_INTEGERS = {"touch": "int8", "group": "int64"}


class ParquetWriter(EndedOutput):
    """Writes readings to Parquet with the columns of CSV, and ``metadata`` in the schema."""

    _items, _kept = "rows", "without its end, it cannot be read"

    def __init__(
        self,
        path: str | Path,
        inputs: Iterable[str | Path] = (),
        also: Sequence[str] = (),
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(path, inputs, "Parquet")
        self._arrow, self._parquet = optional_modules(path, ["pyarrow", "pyarrow.parquet"])
        types = {name: self._arrow.string() for name in (*COLUMNS, *also)}
        types |= dict.fromkeys(NUMBERS, self._arrow.float64())
        types |= {name: self._arrow.float64() for name in also if name in SURFACE_COLUMNS}
        types |= {name: getattr(self._arrow, kind)() for name, kind in _INTEGERS.items()}
        self._schema = self._arrow.schema(types.items(), metadata=dict(metadata or {}))
        self._waiting: list[Mapping[str, Any]] = []

    def _writer_of(self, file: OutputFile) -> Any:
        return self._parquet.ParquetWriter(
            self._arrow.PythonFile(file, mode="w"),
            self._schema,
            compression="zstd",
            write_page_checksum=True,
        )

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self.begin()
        for row in rows:
            with self._writing():
                self._waiting.append(row)
                self.rows += 1
                if len(self._waiting) >= _GROUP_ROWS:
                    self._flush()

    def _write_end(self) -> None:
        try:
            if self._failure is None:
                self._flush()
        finally:
            # Also where a signal ends the process: once collected, it would write to a closed file.
            self._writer.close()

    def _flush(self) -> None:
        """Write the rows that wait as a row group."""
        if self._waiting:
            table = self._arrow.Table.from_pylist(self._waiting, schema=self._schema)
            self._waiting = []
            self._writer.write_table(table)


def open_writer(
    path: str | Path | None = None,
    inputs: Iterable[str | Path] = (),
    also: Sequence[str] = (),
    append: bool = False,
    metadata: Mapping[str, str] | None = None,
    rotation: Rotation | None = None,
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
    rotation : Rotation, optional
        When the file, which is always continued then, is renamed and another begun.

    Returns
    -------
    ReadingsWriter or ParquetWriter

    Raises
    ------
    InputError
        For another suffix, a path that cannot be written to, an input, a Parquet file without
        pyarrow, or one, or standard output, that is to be continued.

    Examples
    --------
    >>> from gnuradio.wiforce.io.readings import Reading
    >>> with open_writer("press.csv") as writer:
    ...     writer.write(Reading(0.018, "arm", 1, 4.12345678, 0.05, 45.0, 0.1))
    >>> print(Path("press.csv").read_text().splitlines()[1])
    0.018,arm,1,4.1235,0.05,45.0,0.1,,,,,,
    """
    form = format_of(path)
    if path is None:
        if append or rotation:
            option = "--append" if append else "--rotate"
            raise InputError(option, "needs a file as output: -o OUT.csv or OUT.jsonl")
        return ReadingsWriter(path, also=also)
    if form is None or form not in OUTPUTS:
        hint = "standard output: leave -o out" if str(path) == "-" else "MCAP: --mcap FILE"
        raise InputError(path, f"output must end in {suffixes(OUTPUTS)} ({hint})")
    if form.text and rotation:
        return RotatingWriter(path, rotation, inputs, also)
    if form.text:
        return ReadingsWriter(path, inputs, also, append)
    if append or rotation:
        raise InputError(path, "nothing can be appended to Parquet; use .csv or .jsonl")
    return ParquetWriter(path, inputs, also, metadata)


def whole_rows(path: str | Path, header: str) -> int:
    """Bytes of the complete rows of a file with this ``header``, whose last may be cut off.

    InputError for a file whose end is no row: nothing but a row, and zeros, may be cut off.
    """
    with open(path, "rb") as file:
        begin, end = _last_line(file)
        file.seek(0)
        first = file.readline(LONGEST_ROW) if begin else file.read(min(end, LONGEST_ROW))
        if first and not _may_begin(first, header.encode()):
            rule = "must begin with the columns of these readings, or nothing can be appended"
            raise InputError(path, rule, first.decode("utf-8", "replace").strip())
    if end - begin > LONGEST_ROW:
        rule = "must end with a row of readings, or nothing can be appended: its last line has"
        raise InputError(path, f"{rule} {end - begin} bytes")
    return begin


def _last_line(file: BinaryIO) -> tuple[int, int]:
    """Where the incomplete last line begins and ends, but for zeros.

    File systems leave zeros for data that had not reached the disk when the power failed.
    """
    end, begin = 0, file.seek(0, os.SEEK_END)
    while begin:
        start = max(begin - LONGEST_ROW, 0)
        file.seek(start)
        block = file.read(begin - start)
        newline = block.rfind(b"\n") + 1
        held = len(block.rstrip(b"\0"))
        if not end and held > newline:
            end = start + held
        begin = start + newline
        if newline:
            break
    return begin, max(begin, end)


def _may_begin(line: bytes, header: bytes) -> bool:
    """Whether a file of readings may begin with a line, which may be incomplete."""
    if not header:
        return line.startswith(b"{")
    return line == header if line.endswith(b"\n") else header.startswith(line)


# Units of a limit, as fields of :class:`Rotation`, and their sizes.
_UNITS = {"s": ("every_s", 1), "min": ("every_s", 60), "h": ("every_s", 3600)}
_UNITS |= {"d": ("every_s", 86400), "kB": ("size_bytes", 1000)}
_UNITS |= {"MB": ("size_bytes", 10**6), "GB": ("size_bytes", 10**9)}
_LIMIT = re.compile(rf"([1-9][0-9]{{0,8}})({'|'.join(_UNITS)})")


@dataclass(frozen=True)
class Rotation:
    """When a file that is written for weeks is renamed, and how many renamed files are kept."""

    every_s: int | None = None  # at whole multiples of it, counted from midnight UTC of 1970-01-01
    size_bytes: int | None = None  # once the file has reached this size
    keep: int | None = None  # renamed files that are kept; None keeps all

    @classmethod
    def of(cls, limits: Iterable[str], keep: int | None = None) -> Rotation:
        """A rotation from at most one time like ``6h`` and one size like ``100MB``."""
        found: dict[str, int] = {}
        for text in limits:
            match = _LIMIT.fullmatch(text)
            if match is None:
                units = "a time in s, min, h or d, or a size in kB, MB or GB"
                raise InputError("--rotate", f"must be {units}, like 6h or 100MB", text)
            kind, size = _UNITS[match[2]]
            if kind in found:
                raise InputError("--rotate", "may be given once for time and once for size", text)
            found[kind] = int(match[1]) * size
        if keep is not None and not found:
            raise InputError("--keep", "needs --rotate", keep)
        return cls(**found, keep=keep)

    def __bool__(self) -> bool:
        return self.every_s is not None or self.size_bytes is not None


class RotatingWriter(ReadingsWriter):
    """Writes readings to a file that is renamed by its last row's time, and begun anew."""

    def __init__(
        self,
        path: str | Path,
        rotation: Rotation,
        inputs: Iterable[str | Path] = (),
        also: Sequence[str] = (),
        now: Callable[[], float] = time.time,
    ) -> None:
        self._whole, self._rotation, self._now = Path(path), rotation, now
        if self._whole.exists() and not self._whole.is_file():
            raise InputError("--rotate", "needs a regular file as output", str(path))
        super().__init__(path, inputs, also, append=True)
        if not os.access(self._whole.absolute().parent, os.W_OK):
            raise InputError(path, "its folder must be writable, for files that are renamed")
        self._last_s: float | None = None
        self._renamed_ms = 0
        self._period = self._period_of(now())

    def begin(self) -> RotatingWriter:
        """Continue the file, or begin another when its time is over."""
        if not self._begun and self._whole.exists() and self._whole.stat().st_size:
            if self._period_of(self._whole.stat().st_mtime) != self._period:
                self._rename()
        super().begin()
        return self

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write rows; OutputError also when the file cannot be renamed."""
        for row in rows:
            if row["time_s"] != self._last_s and self._last_s is not None and self._is_due():
                self.abandon()
                self._begun = False
                self._rename()
            self._last_s = row["time_s"]
            super().write_rows([row])

    def _period_of(self, time_s: float) -> int:
        return int(time_s // self._rotation.every_s) if self._rotation.every_s else 0

    def _is_due(self) -> bool:
        period, self._period = self._period, self._period_of(self._now())
        limit, size = self._rotation.size_bytes, self._file.size_bytes if self._file else 0
        return period != self._period or (limit is not None and size >= limit)

    def _rename(self) -> None:
        try:
            # Names must rise, also when files are small or the clock is set back.
            ended_ms = max(self._whole.stat().st_mtime_ns // 10**6, self._renamed_ms + 1)
            while (target := self._target(ended_ms)).exists():
                ended_ms += 1
            self._whole.rename(target)
            self._renamed_ms = ended_ms
            self._delete_old()
        except OSError as error:
            rule = f"cannot be renamed ({error.strerror}); all rows until then are kept"
            raise OutputError(self._whole, rule) from error

    def _target(self, ended_ms: int) -> Path:
        ended = time.strftime("%Y%m%dT%H%M%S", time.gmtime(ended_ms // 1000))
        name = f"{self._whole.stem}-{ended}.{ended_ms % 1000:03d}Z{self._whole.suffix}"
        return self._whole.with_name(name)

    def _delete_old(self) -> None:
        if self._rotation.keep is None:
            return
        stem, suffix = re.escape(self._whole.stem), re.escape(self._whole.suffix)
        name = re.compile(rf"{stem}-\d{{8}}T\d{{6}}\.\d{{3}}Z{suffix}")
        folder = self._whole.absolute().parent
        renamed = sorted(path for path in folder.iterdir() if name.fullmatch(path.name))
        for path in renamed[: -self._rotation.keep]:
            path.unlink(missing_ok=True)
