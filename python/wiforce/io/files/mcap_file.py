# SPDX-License-Identifier: GPL-3.0-or-later
"""MCAP files of readings: their rows, and the file that a run writes."""

import math
import os
import struct
import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ...errors import InputError, OutputError
from ..optional import optional_module, optional_modules
from ..readings import NUMBERS, written_utc
from ..ros_messages import (
    DIAGNOSTICS,
    READING,
    WRENCH,
    RosMessage,
    complete_definition,
    fields_of,
    health_message,
    reading_messages,
    topics_of,
)
from ..text.textfile import check_output
from .output_file import OutputFile, ReadingsOutput

_MODULES = ("mcap.stream_reader", "mcap.exceptions", "mcap.records", "mcap_ros2.decoder")
_MAGIC = b"\x89MCAP0\r\n"
# Numbers that not every reading has: y of a surface, and the time of a device.
_FURTHER = tuple(
    name
    for name, (kind, _) in fields_of(READING).items()
    if kind == "float64" and name not in NUMBERS
)


def mcap_is_cut(path: str | Path) -> bool:
    """Whether an MCAP file does not end as one that was written to its end."""
    try:
        with open(path, "rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise InputError(path, "is not an MCAP file")
            file.seek(-len(_MAGIC), os.SEEK_END)
            return file.read() != _MAGIC or file.tell() == len(_MAGIC)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error


def mcap_rows(path: str | Path) -> Iterator[dict[str, Any]]:
    """Rows of the readings in a file, in the order in which they were written.

    The index of the file is not needed, so all complete chunks of a file are read that a killed
    process has left. Rows are columns of a reading, ``run`` and ``time_utc``; where known,
    ``device_time_s`` and the y of a press on a surface.
    """
    stream, errors, records, decoder = optional_modules(path, _MODULES)
    decoders = decoder.DecoderFactory()
    schemas: dict[int, Any] = {}
    decoder_of: dict[int, Any] = {}
    cut = mcap_is_cut(path)
    try:
        with open(path, "rb") as file:
            for record in stream.StreamReader(file, validate_crcs=True).records:
                if isinstance(record, records.Schema) and record.name == READING:
                    schemas[record.id] = record
                elif isinstance(record, records.Channel) and record.schema_id in schemas:
                    schema = schemas[record.schema_id]
                    decoder_of[record.id] = decoders.decoder_for(record.message_encoding, schema)
                elif isinstance(record, records.Message) and record.channel_id in decoder_of:
                    yield _row(decoder_of[record.channel_id](record.data))
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except (errors.EndOfFile, struct.error) as error:
        if not cut:
            raise InputError(path, "is a damaged MCAP file (a record is too long)") from error
        return  # what a killed process had not written yet
    except InputError:
        raise
    except Exception as error:  # damage ends in errors of the decompressor and the decoder as well
        raise InputError(path, f"is a damaged MCAP file ({error})") from error


def _row(message: Any) -> dict[str, Any]:
    numbers = {name: getattr(message, name) for name in (*NUMBERS, *_FURTHER)}
    row: dict[str, Any] = {
        name: None if math.isnan(value) else value
        for name, value in numbers.items()
        if name in NUMBERS or not math.isnan(value)
    }
    return row | {
        "sensor": message.sensor,
        "touch": None if message.touch < 0 else message.touch,
        "flags": " ".join(message.flags),
        "group": None if message.group < 0 else message.group,
        "run": message.run,
        "time_utc": written_utc(_utc_s(message.header.stamp)),
    }


def _utc_s(stamp: Any) -> float | None:
    return stamp.sec + stamp.nanosec / 1e9 if stamp.sec else None


# A chunk is written when it holds so much. At 28 readings/s a sensor fills one in a second: what a
# process that is killed loses. Larger ones compress better, and their index takes less memory.
_CHUNK_BYTES = 8_192
# Enough for the last chunk and the index of some twelve hours of one sensor.
_RESERVE_BYTES = 4_000_000
_KEPT = "all messages but those of the last seconds are kept"


class McapWriter(ReadingsOutput):
    """Writes readings and health to an MCAP file; may be used by several threads.

    The former content of a file is kept until :meth:`begin` or the first reading. As a context
    manager it ends the file, also after an error. ``inputs`` are files that must not be written to,
    ``metadata`` is stored as ``gr-wiforce``, ``sensors`` are those known before the first reading;
    two must not have the same topics.

    Messages are logged at the time of their header, so that the time axis of a viewer is that of
    the measurement. Where UTC is not known, that of the previous message counts and, in a file
    without any, the time of the reading, from 1970 on.
    """

    def __init__(
        self,
        path: str | Path,
        inputs: Iterable[str | Path] = (),
        metadata: Mapping[str, str] | None = None,
        sensors: Iterable[str] = (),
    ) -> None:
        check_output(path, inputs)
        self._sensors = dict.fromkeys(sensors)
        topics_of(self._sensors)
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(path, "MCAP needs a regular file")
        self._library = optional_module("mcap_ros2.writer", path)
        self._path, self._metadata = path, dict(metadata or {})
        self._lock = threading.Lock()
        self._file: OutputFile | None = None
        self._writer: Any = None
        self._schemas: dict[str, Any] = {}
        self._failure: OutputError | None = None
        self._ended = False
        self._utc_ns: int | None = None

    def begin(self) -> "McapWriter":
        """Replace the content of the file, unless that has been done.

        Refuses a file that another process is writing to; OutputError when it cannot be written to.
        """
        with self._lock:
            if self._file is None:
                self._file = OutputFile(self._path, kept=_KEPT, reserve_bytes=_RESERVE_BYTES)
                self._writer = self._library.Writer(self._file, chunk_size=_CHUNK_BYTES)
                for name in (READING, WRENCH, DIAGNOSTICS):
                    text = complete_definition(name)
                    self._schemas[name] = self._writer.register_msgdef(name, text)
                if self._metadata:
                    self._writer.add_metadata("gr-wiforce", self._metadata)
        return self

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Write one reading given as a row; no two sensors may have the same topics."""
        self.begin()
        if row["sensor"] not in self._sensors:
            topics_of([*self._sensors, row["sensor"]])
            self._sensors[row["sensor"]] = None
        for message in reading_messages(row):
            self._put(message, round(row["time_s"] * 1e9))
        self.rows += 1

    def write_health(self, report: Mapping[str, Any]) -> None:
        """Write a heartbeat or the end of a run; nothing before the file is begun.

        A failure is reported by the next reading, or when the file is closed.
        """
        if self._writer is not None and self._failure is None:
            try:
                self._put(health_message(report), 0)
            except OutputError:
                pass

    def close(self) -> None:
        """Write the last messages and the index, or raise OutputError."""
        self.begin()
        self._end()
        if self._failure is not None:
            raise self._failure

    def _abandon(self) -> None:
        if self._writer is None:
            return
        try:
            self._end()
        except OutputError:
            pass  # the first error counts

    def _put(self, message: RosMessage, else_ns: int) -> None:
        with self._lock:
            if self._failure is not None:
                raise self._failure
            if self._ended:
                return
            self._utc_ns = message.stamp_ns or self._utc_ns
            time_ns = else_ns if self._utc_ns is None else self._utc_ns
            schema, sequence = self._schemas[message.type], self.rows
            try:
                self._writer.write_message(
                    message.topic, schema, message.fields, time_ns, time_ns, sequence
                )
            except OutputError as error:
                self._failure = error
                raise
            if self._file is not None and self._file.reserve_used:
                self._end_on_full_disk()

    def _end_on_full_disk(self) -> None:
        rule = "cannot be written further (disk full); all messages until then are kept"
        self._failure = OutputError(self._path, rule)
        self._finish()
        raise self._failure

    def _end(self) -> None:
        with self._lock:
            self._finish()

    def _finish(self) -> None:
        if self._ended or self._file is None:
            return
        self._ended = True
        try:
            if self._failure is None or self._file.reserve_used:
                self._writer.finish()
        except OutputError as error:
            self._failure = error
        finally:
            self._file.close()
