# SPDX-License-Identifier: GPL-3.0-or-later
"""Parquet files of readings, for data frames."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..optional import optional_modules
from ..readings import COLUMNS, NUMBERS, SURFACE_COLUMNS
from .output_file import EndedOutput, OutputFile

# So many rows wait in memory, some 2 MB, and are written at once: 2.4 min of one sensor.
_GROUP_ROWS = 4096
_INTEGERS = {"touch": "int8", "group": "int64"}


class ParquetWriter(EndedOutput):
    """Writes readings to a Parquet file, with the columns and values of a CSV file.

    ``also`` are columns that follow those of a reading: those of a surface, and others of text;
    ``metadata`` is stored in the file's schema.
    """

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
        if self._failure is None:
            self._flush()
        self._writer.close()

    def _flush(self) -> None:
        """Write the rows that wait as a row group."""
        if self._waiting:
            table = self._arrow.Table.from_pylist(self._waiting, schema=self._schema)
            self._waiting = []
            self._writer.write_table(table)
