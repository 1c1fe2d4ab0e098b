# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings, written a row at a time: CSV or JSON lines; Parquet by parquet.py."""

import csv
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..readings import COLUMNS
from ..text.textfile import check_output
from .output_file import OutputFile
from .parquet import ParquetWriter
from .readings_output import ReadingsOutput

# The longest row that a run may have left incomplete when its machine failed.
_LONGEST_ROW = 65_536


class ReadingsWriter(ReadingsOutput):
    """Writes readings, a row each; every row is in the file at once, and whole.

    The previous content of a file is kept until the first row is written, the writer is closed
    without one, or :meth:`begin` is called: a run that is refused or fails before that loses
    nothing. As a context manager it closes the file after success, and otherwise keeps what has
    been written.

    Parameters
    ----------
    path : str or Path, optional
        Standard output by default.
    form : callable
        From a reading's ``row()`` to a line of text.
    header : str
        First line.
    inputs : iterable of str or Path, optional
        Files that the readings are made from, none of which may be written to.
    append : bool
        Keep the previous content, which must have the same header.

    Attributes
    ----------
    rows : int
        Readings written so far.

    Raises
    ------
    InputError
        When the path cannot be written to, or is an input.
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

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Write one reading given as a row.

        Parameters
        ----------
        row : mapping
            All columns, in their order.

        Raises
        ------
        OutputError
            As :meth:`write`.
        """
        self.begin()
        self._put(self._form(row))
        self.rows += 1

    def close(self) -> None:
        """Close the file; one without readings holds its header only.

        Raises
        ------
        InputError, OutputError
            As :meth:`begin`.
        """
        self.begin()
        if self._file is not None:
            self._file.close()

    def begin(self) -> "ReadingsWriter":
        """Empty the file except for its header, or prepare to append, unless that has been done.

        Returns ReadingsWriter: itself.

        Raises
        ------
        InputError
            When the file cannot be opened, another process is writing to it, or it has other
            columns than those that are appended.
        OutputError
            When it cannot be written to.
        """
        if self._begun:
            return self
        if self._path is not None:
            continued = self._append and Path(self._path).is_file()
            self._file = OutputFile(self._path, append=continued)
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
    name = "" if path is None else str(path).lower()
    if name.endswith(".jsonl"):
        return ReadingsWriter(
            path,
            lambda row: json.dumps(row, allow_nan=False) + "\n",
            inputs=inputs,
            append=append,
        )
    if path is not None and name.endswith(".parquet"):
        if append:
            raise InputError(path, "nothing can be appended to Parquet; use .csv or .jsonl")
        return ParquetWriter(path, inputs, also, metadata)
    if path is not None and not name.endswith(".csv"):
        raise InputError(path, "output must end in .csv, .jsonl or .parquet")
    columns = (*COLUMNS, *also)
    return ReadingsWriter(
        path,
        lambda row: _csv_line([row.get(name) for name in columns]),
        _csv_line(columns),
        inputs,
        append,
    )


def prepare_append(path: str | Path, header: str) -> int:
    """Check that a file can be appended to, and cut off a last row that is incomplete.

    Returns int: size of the file in bytes, 0 when it does not exist or is empty.

    Parameters
    ----------
    path : str or Path
        A regular file.
    header : str
        First line that the file must have, with its newline; empty when there is none.

    Raises
    ------
    InputError
        When the file begins with another line.
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
