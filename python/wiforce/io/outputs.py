# SPDX-License-Identifier: GPL-3.0-or-later
"""Outputs of readings: files and sockets behind one interface, which all get the same rows."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from typing import Any, TypeVar

from .readings import Reading

# What files hold of a live run besides the reading; sockets get ``device_time_s`` as well.
STAMP_COLUMNS = ("run", "time_utc")
Self = TypeVar("Self", bound="Output")


class Output:
    """One output of readings; what a derived class does not override does nothing.

    Rows come from the reader's thread, which must not wait for a peer; ``send`` from those of
    heartbeat and run, perhaps at once. As a context manager it is closed, and kept on errors.
    """

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def begin(self: Self) -> Self:
        """Say that rows follow: the run may be refused before, and no file is changed."""
        return self

    def write(self, reading: Reading, more: Mapping[str, Any] | None = None) -> None:
        """Write one reading and values of further columns; OutputError for it or one before it."""
        self.write_rows([{**reading.row(), **(more or {})}])

    def write_all(self, readings: Iterable[Reading]) -> None:
        """Write readings that came together, as :meth:`write` does."""
        self.write_rows([reading.row() for reading in readings])

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write readings given as rows of a file, with all columns in their order."""
        raise NotImplementedError

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Take a report of the reader's health: a ``heartbeat``, or the ``end`` of a run."""

    def close(self) -> None:
        """End in good order, or raise OutputError where what was taken cannot be written."""

    def abandon(self) -> None:
        """End after an error, which counts rather than any of this output."""
        self.close()


class Outputs(Output):
    """Outputs that get the same rows, and are ended in reverse order.

    ``needs_all``: the first that cannot be written further ends them, rather than the last.
    """

    rows = 0  # given to all of them so far
    failure: OSError | None = None  # of the first that cannot be written further

    def __init__(self, *outputs: Output, needs_all: bool = False) -> None:
        self._needs_all = needs_all
        self._outputs: list[Output] = []
        self._ending = ExitStack()
        for output in outputs:
            self.add(output)

    def __exit__(self, *error: Any) -> None:
        self._ending.__exit__(*error)
        # An interruption does not hide it.
        if self.failure is not None and not isinstance(error[1], Exception):
            raise self.failure

    def add(self, output: Output) -> None:
        self._outputs.append(self._ending.enter_context(output))

    def begin(self) -> "Outputs":
        for output in self._outputs:
            output.begin()
        return self

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Give rows to all outputs; raises the first ``failure`` where that ends them."""
        rows, failed = list(rows), 0
        for output in self._outputs:
            try:
                output.write_rows(rows)
            except OSError as error:
                self.failure, failed = self.failure or error, failed + 1
        if self.failure is not None and (self._needs_all or failed == len(self._outputs)):
            raise self.failure
        self.rows += len(rows)

    def close(self) -> None:
        self._ending.close()

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        for output in self._outputs:
            output.send(kind, report)
