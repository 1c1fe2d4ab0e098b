# SPDX-License-Identifier: GPL-3.0-or-later
"""Outputs of a live run: any number of them behind one interface."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from typing import Any

from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.files.writers import ReadingsWriter, RotatingWriter
from gnuradio.wiforce.io.network.zmq_keys import ServerKeys
from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher
from gnuradio.wiforce.io.readings import Reading

# Files in a folder of MCAP are ended at this size, some seven hours of one sensor: the index of an
# open file takes memory, a quarter of its size.
MCAP_FILE_BYTES = 64_000_000
# What a file of readings holds of a stamp.
STAMP_COLUMNS = ("run", "time_utc")


class Output:
    """One output of a run; what a derived class does not override does nothing.

    ``take`` is called by the thread of the reader, which must never wait for a peer: an output to
    the network drops readings for slow peers, a file writes at once. ``send`` is called by the
    threads of heartbeat and run, so it may coincide with ``take``.
    """

    def begin(self) -> None:
        """The device is open; called again when it is opened anew.

        Before that, the run may be refused, and no existing file may be changed.
        """

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Take one reading.

        ``stamp``: ``device_time_s``, ``run`` and ``time_utc`` of the reading, as :class:`RunHealth`
        gives them. Raises OutputError when it cannot be written; this ends the run.
        """

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Take a report of the reader's health.

        ``kind``: ``heartbeat``, or ``end`` for the last one of a run.
        """

    def close(self) -> None:
        """End in good order; called once, also after a failure.

        Raises OutputError when what was taken cannot be written completely.
        """


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


class ZmqMessages(Output):
    """Readings and health as JSON over ZMQ."""

    def __init__(self, endpoint: str, keys: ServerKeys | None):
        self._publisher = ReadingsPublisher(endpoint, keys=keys)

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Publish one reading."""
        self._publisher.publish(reading, stamp)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Publish a report."""
        self._publisher.send(kind, report)

    def close(self) -> None:
        """Give the endpoint back."""
        self._publisher.close()


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


class FoxgloveMessages(Output):
    """The messages of an MCAP file for Foxglove clients."""

    def __init__(self, address: str, sensors: Iterable[str]):
        from gnuradio.wiforce.io.network.foxglove_server import FoxgloveServer

        self._server = FoxgloveServer(address, sensors)

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Send one reading."""
        self._server.publish(reading, stamp)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Send a report."""
        self._server.publish_health(report)

    def close(self) -> None:
        """Disconnect all clients."""
        self._server.close()


class LslStreams(Output):
    """A stream of the Lab Streaming Layer for each sensor."""

    def __init__(self, scene, reach: str, details: Mapping[str, str]):
        from gnuradio.wiforce.io.network.lsl_outlets import LslOutlets

        network = reach == "network"
        self._outlets = LslOutlets(
            scene.sensor_names,
            scene.group_period_s,
            network,
            details,
            surfaces=scene.surface.names if scene.surface is not None else (),
        )

    def take(self, reading: Reading, stamp: Mapping[str, Any]) -> None:
        """Send one sample."""
        self._outlets.push(reading, stamp["time_utc"])

    def close(self) -> None:
        """End the streams."""
        self._outlets.close()


class LiveOutputs:
    """All outputs of a run. As a context manager it closes them, the latest first.

    ``health``: of the run; set before the first reading; ``seen``: takes every reading after the
    outputs; ``readings``: number of readings that all outputs have taken.
    """

    def __init__(self) -> None:
        self._outputs: list[Output] = []
        self._closing = ExitStack()
        self.health = None
        self.readings = 0
        self.seen: Callable[[Reading], None] = lambda reading: None

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

    def take(self, reading: Reading) -> None:
        """Give one reading to all outputs, also to those behind one that fails.

        Raises the OutputError of the first output that failed.
        """
        health = self.health
        stamp = {"device_time_s": health.device_time_s(reading), **health.stamp(reading)}
        failure = None
        for output in self._outputs:
            try:
                output.take(reading, stamp)
            except OutputError as error:
                failure = failure or error
        if failure is not None:
            raise failure
        self.readings += 1
        health.note(reading)
        self.seen(reading)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Give a report of the reader's health to all outputs."""
        for output in self._outputs:
            output.send(kind, report)
