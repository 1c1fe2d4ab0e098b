# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings, read a row at a time: CSV, JSON lines, Parquet or MCAP."""

import csv
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

from ...errors import InputError
from ..optional import optional_module
from ..readings import COLUMNS, NUMBERS, SURFACE_COLUMNS
from . import FORMATS, format_of, suffixes
from .mcap_file import mcap_is_cut, mcap_rows

_INTEGERS = ("touch", "group")
_NEEDED = ("time_s", "sensor")
_FLOATS = frozenset((*NUMBERS, *SURFACE_COLUMNS, "device_time_s"))
_BATCH_ROWS = 4096


def frame_rows(frame: Any) -> list[dict[str, Any]]:
    """Rows of a pandas frame of readings, flags one text."""
    if "flags" in frame:  # pandas reads no flags as NaN from a file
        frame = frame.assign(flags=frame["flags"].fillna(""))
    return list(frame.to_dict("records"))


class ReadingsFile:
    """A file of readings of any length: ``.csv``, ``.jsonl``, ``.parquet`` or ``.mcap``.

    ``also`` are further columns, ``metadata`` what Parquet says; ``note`` that MCAP lacks its end.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self.metadata: dict[str, str] = {}
        if (form := format_of(path)) is None:
            raise InputError(path, f"readings must be in a {suffixes(FORMATS)} file")
        readers: dict[str, Callable[[], Iterator[Mapping[str, Any]]]] = {
            ".csv": self._csv,
            ".jsonl": self._json_lines,
            ".parquet": self._parquet,
            ".mcap": partial(mcap_rows, path),
        }
        self._rows = readers[form.suffix]
        self.note, self._cut = "", form.suffix == ".mcap" and mcap_is_cut(path)
        # Those of a table. In other files, a row may have a column that no row before it has.
        self._columns: tuple[str, ...] | None = None
        found: dict[str, None] = {}
        for row in self._rows():
            if self._columns is not None:
                break
            found |= dict.fromkeys(row)
        names = tuple(found) if self._columns is None else self._columns
        if self._cut and not names:
            raise InputError(path, "is cut off before its first reading is complete")
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            raise InputError(path, "columns must have different names", repeated[0])
        for name in _NEEDED:
            if (names or self._columns is not None) and name not in names:
                raise InputError(path, f"is no file of readings: it has no column {name}")
        self.also = tuple(name for name in names if name not in COLUMNS)

    def rows(self) -> Iterator[dict[str, Any]]:
        """All rows, by the columns of a reading and ``also``; unknown values None, flags a text."""
        number = 0
        for number, row in enumerate(self._rows(), 1):
            try:
                yield self._typed(row)
            except (TypeError, ValueError) as error:
                where = f"{self._path}: row {number}"
                raise InputError(where, f"is no reading ({error})") from None
        if self._cut:
            self.note = (
                f"ends behind reading {number} without a regular end: it is still being written, "
                "or what followed is lost"
            )

    def _typed(self, row: Mapping[str, Any]) -> dict[str, Any]:
        typed: dict[str, Any] = {name: row.get(name) for name in (*COLUMNS, *self.also)}
        for name, value in typed.items():
            if name not in COLUMNS and name not in _FLOATS:
                typed[name] = _text(value)
            elif value == "" or value is None:
                typed[name] = None
            elif name in _FLOATS:
                typed[name] = _number(name, value)
            elif name in _INTEGERS:
                typed[name] = _integer(name, value)
            elif not isinstance(value, str):
                raise ValueError(f"{name} must be a text")
        if typed["time_s"] is None or typed["sensor"] is None:
            raise ValueError("time_s and sensor must be given")
        if typed["group"] is not None and not 0 <= typed["group"] < 2**63:
            raise ValueError("group must be an index")
        if typed["touch"] not in (None, 0, 1):
            raise ValueError("touch must be 0, 1 or empty")
        typed["flags"] = typed["flags"] or ""
        return typed

    def _csv(self) -> Iterator[Mapping[str, Any]]:
        with self._opened() as file:
            try:
                lines = csv.reader(file, strict=True)
                names = next(lines, [])
                if not any(names):
                    rule = "must have a first row with the names of its columns"
                    raise InputError(self._path, rule)
                self._columns = tuple(names)
                for fields in lines:
                    if len(fields) == len(names):
                        yield dict(zip(names, fields, strict=True))
                    elif fields:
                        where = f"{self._path}: line {lines.line_num}"
                        rule = f"must have as many fields as there are columns, {len(names)}"
                        raise InputError(where, rule, len(fields))
            except csv.Error as error:
                raise InputError(self._path, f"is not a CSV file ({error})") from error

    def _json_lines(self) -> Iterator[Mapping[str, Any]]:
        with self._opened() as file:
            for number, line in enumerate(file, 1):
                try:
                    row = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise InputError(f"{self._path}: line {number}", "is not JSON") from error
                if not isinstance(row, dict):
                    raise InputError(f"{self._path}: line {number}", "must be a JSON object")
                yield row

    def _parquet(self) -> Iterator[Mapping[str, Any]]:
        arrow = optional_module("pyarrow", self._path)
        import pyarrow.parquet

        try:
            # pyarrow itself opens no path whose name is not UTF-8.
            with (
                open(self._path, "rb") as source,
                pyarrow.parquet.ParquetFile(source, page_checksum_verification=True) as file,
            ):
                stored = file.schema_arrow.metadata or {}
                known = {
                    key.decode(errors="replace"): value.decode(errors="replace")
                    for key, value in stored.items()
                }
                self.metadata = {k: v for k, v in known.items() if k.startswith("wiforce:")}
                self._columns = tuple(file.schema_arrow.names)
                # pyarrow's threads may abort a process that ends soon after.
                for batch in file.iter_batches(_BATCH_ROWS, use_threads=False):
                    yield from batch.to_pylist()
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror or error})") from error
        except (arrow.ArrowException, UnicodeDecodeError) as error:
            raise InputError(self._path, "is not a complete Parquet file") from error

    @contextmanager
    def _opened(self) -> Iterator[IO[str]]:
        try:
            with open(self._path, encoding="utf-8-sig", newline="") as file:
                yield file
        except UnicodeDecodeError as error:
            raise InputError(self._path, f"is not UTF-8 ({error})") from error
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})") from error


def _text(value: Any) -> str:
    """A value of a column that is none of a reading's, as a text; of JSON lines, in JSON."""
    if isinstance(value, dict | list | bool):
        return json.dumps(value)
    return "" if value is None else str(value)


def _number(name: str, value: Any) -> float | None:
    """A finite number; None for NaN, as which other programs write what is unknown."""
    if isinstance(value, bool) or "_" in str(value):  # Python reads 1_0 as ten
        raise ValueError(f"{name} must be a number")
    number = float(value)
    if math.isinf(number):
        raise ValueError(f"{name} must be finite")
    return None if math.isnan(number) else number


def _integer(name: str, value: Any) -> int | None:
    """An integer, also one written as 1.0, as pandas does in a column that has empty fields."""
    if isinstance(value, int) or isinstance(value, str) and value.strip().lstrip("+-").isdecimal():
        return int(value)
    number = _number(name, value)
    if number is None:
        return None
    if not number.is_integer() or abs(number) >= 2**53:
        raise ValueError(f"{name} must be an integer")
    return int(number)
