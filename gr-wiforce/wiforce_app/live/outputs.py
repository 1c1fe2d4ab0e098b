# SPDX-License-Identifier: GPL-3.0-or-later
"""Outputs of a live run: any number of them behind one interface; sockets have it themselves."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.files.writers import ReadingsWriter, RotatingWriter
from gnuradio.wiforce.io.readings import Output, Reading

# Files in a folder of MCAP are ended at this size, some seven hours of one sensor: the index of an
# open file takes memory, a quarter of its size.
MCAP_FILE_BYTES = 64_000_000
# What a file of readings holds of a stamp.
STAMP_COLUMNS = ("run", "time_utc")


class TableFile(Output):
    """A file of readings that has a row for each, or standard output."""

    def __init__(self, writer: ReadingsWriter | RotatingWriter):
        self._writer = writer

    def begin(self) -> None:
        """Replace the content of the file, unless it is appended to."""
        self._writer.begin()

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Write a row."""
        self._writer.write(reading, {key: stamp[key] for key in STAMP_COLUMNS})


class McapFile(Output):
    """An MCAP file of readings and health, or a folder of such files.

    ``open_next``: opens a writer: of the file, or of the next file in the folder; ``most_bytes``:
    size at which the next file is begun; None for a single file.
    """

    def __init__(self, open_next: Callable[[], Any], most_bytes: int | None = None):
        self._open_next, self._most_bytes = open_next, most_bytes
        self._writer, self._begun = open_next(), False

    def begin(self) -> None:
        """Replace the content of the file."""
        self._writer.begin()
        self._begun = True

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Write the messages of a reading."""
        self._writer.write(reading, stamp)
        if self._most_bytes is not None and self._writer.size_bytes >= self._most_bytes:
            full, self._writer = self._writer, self._open_next().begin()
            full.close()

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Write a report."""
        self._writer.write_health(report)

    def close(self) -> None:
        """End the file; a run that was refused leaves the former one as it was."""
        if self._begun:
            self._writer.close()


class LiveOutputs:
    """All outputs of a run. As a context manager it closes them, the latest first.

    ``readings``: number of readings that all outputs have taken.
    """

    def __init__(self) -> None:
        self._outputs: list[Output] = []
        self._closing = ExitStack()
        self.readings = 0

    def __enter__(self) -> "LiveOutputs":
        return self

    def __exit__(self, *error) -> bool | None:
        return self._closing.__exit__(*error)

    def add(self, output: Output) -> None:
        """Add an output."""
        self._outputs.append(output)
        self._closing.callback(output.close)

    def begin(self) -> None:
        """The device is open."""
        for output in self._outputs:
            output.begin()

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Give one reading to all outputs, also to those behind one that fails.

        Raises the OutputError of the first output that failed.
        """
        failure = None
        for output in self._outputs:
            try:
                output.take(reading, stamp)
            except OutputError as error:
                failure = failure or error
        if failure is not None:
            raise failure
        self.readings += 1

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Give a report of the reader's health to all outputs."""
        for output in self._outputs:
            output.send(kind, report)
