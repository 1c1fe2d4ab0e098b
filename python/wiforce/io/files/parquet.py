# SPDX-License-Identifier: GPL-3.0-or-later
"""Parquet files of readings, for data frames."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...errors import InputError, OutputError
from ..optional import optional_module
from ..readings import COLUMNS, NUMBERS, SURFACE_COLUMNS
from ..text.textfile import check_output
from .output_file import OutputFile, ReadingsOutput

# So many rows wait in memory, some 2 MB, and are written at once: 2.4 min of one sensor.
_GROUP_ROWS = 4096
# Enough for the last rows and the index of two days of one sensor.
_RESERVE_BYTES = 4_000_000
_INTEGERS = {"touch": "int8", "group": "int64"}


class ParquetWriter(ReadingsOutput):
    """Writes readings to a Parquet file, with the columns and values of a CSV file.

    The former content of a file is kept until the first reading, :meth:`begin` or :meth:`close`.
    The file is valid once it is closed. As a context manager it ends the file, also after an error.
    ``also`` are columns that follow those of a reading: those of a surface, and others of text;
    ``metadata`` is stored in the file's schema.
    """

    def __init__(
        self,
        path: str | Path,
        inputs: Iterable[str | Path] = (),
        also: Sequence[str] = (),
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        check_output(path, inputs)
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(path, "Parquet needs a regular file")
        self._arrow = optional_module("pyarrow", path)
        self._parquet = optional_module("pyarrow.parquet", path)
        self._path = path
        types = {name: self._arrow.string() for name in (*COLUMNS, *also)}
        types |= dict.fromkeys(NUMBERS, self._arrow.float64())
        types |= {name: self._arrow.float64() for name in also if name in SURFACE_COLUMNS}
        types |= {name: getattr(self._arrow, kind)() for name, kind in _INTEGERS.items()}
        self._schema = self._arrow.schema(types.items(), metadata=dict(metadata or {}))
        self._waiting: list[Mapping[str, Any]] = []
        self._file: OutputFile | None = None
        self._writer: Any = None
        self._failure: OutputError | None = None

    def begin(self) -> "ParquetWriter":
        """Replace the content of the file, unless done; errors as of :class:`OutputFile`."""
        if self._file is None:
            kept = "without its end, it cannot be read"
            self._file = OutputFile(self._path, kept=kept, reserve_bytes=_RESERVE_BYTES)
            self._writer = self._parquet.ParquetWriter(
                self._arrow.PythonFile(self._file, mode="w"),
                self._schema,
                compression="zstd",
                write_page_checksum=True,
            )
        return self

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Write one reading given as a row of a file."""
        self.begin()
        if self._failure is not None:
            raise self._failure
        self._waiting.append(row)
        self.rows += 1
        if len(self._waiting) >= _GROUP_ROWS:
            self._flush()

    def close(self) -> None:
        """Write the rows that wait, and the end of the file."""
        self.begin()
        if self._file is None or self._file.closed:
            return
        try:
            if self._failure is None:
                self._flush()
        finally:
            self._end()
        if self._failure is not None:
            raise self._failure

    def _abandon(self) -> None:
        try:
            self.close()
        except OutputError:
            pass  # the first error counts

    def _flush(self) -> None:
        """Write the rows that wait as a row group."""
        if not self._waiting:
            return
        table = self._arrow.Table.from_pylist(self._waiting, schema=self._schema)
        self._waiting = []
        try:
            self._writer.write_table(table)
        except OutputError as error:
            self._failure = error
            raise
        if self._file is not None and self._file.reserve_used:
            rule = "cannot be written further (disk full); all rows until then are kept"
            self._failure = OutputError(self._path, rule)
            self._end()
            raise self._failure

    def _end(self) -> None:
        if self._file is None or self._file.closed:
            return
        try:
            if self._writer is not None:  # the disk may have been full from the start
                self._writer.close()
        except OutputError as error:
            self._failure = self._failure or error
        finally:
            self._file.close()
