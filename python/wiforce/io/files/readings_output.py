# SPDX-License-Identifier: GPL-3.0-or-later
"""What all files of readings have in common, whatever their format."""

from collections.abc import Mapping
from types import TracebackType
from typing import Any, TypeVar

from ..readings import Reading
from .output_file import OutputFile

Output = TypeVar("Output", bound="ReadingsOutput")


class ReadingsOutput:
    """A file of readings that derived classes begin, fill row by row and end.

    As a context manager it is closed after success; after an error `_abandon` keeps what it can.

    Attributes
    ----------
    rows : int
        Readings written so far.
    """

    _file: OutputFile | None = None
    rows = 0

    def __enter__(self: Output) -> Output:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        elif self._file is not None:
            self._abandon()

    @property
    def size_bytes(self) -> int:
        """Size of the file."""
        return 0 if self._file is None else self._file.size_bytes

    def write(self, reading: Reading, more: Mapping[str, Any] | None = None) -> None:
        """Write one reading.

        Parameters
        ----------
        more : mapping of str to plain values, optional
            Of the columns that follow those of a reading.

        Raises
        ------
        OutputError
            When it, or a reading before it, cannot be written.
        """
        self.write_row({**reading.row(), **(more or {})})

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Write one reading given as a row; see the derived classes."""
        raise NotImplementedError

    def close(self) -> None:
        """End the file; see the derived classes."""
        raise NotImplementedError

    def _abandon(self) -> None:
        """End the file after an error, which counts rather than any of its own."""
        raise NotImplementedError
