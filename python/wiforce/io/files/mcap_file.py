# SPDX-License-Identifier: GPL-3.0-or-later
"""MCAP files of readings: their rows, and the file that a run writes."""

import math
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ...errors import InputError, OutputError
from ..optional import optional_module, optional_modules
from ..readings import NUMBERS, written_utc
from ..ros_messages import (
    DIAGNOSTICS,
    NUMBERS_OF_READING,
    READING,
    WRENCH,
    RosMessage,
    complete_definition,
    health_message,
    reading_messages,
    topics_of,
)
from .output_file import EndedOutput, OutputFile

_MODULES = ("mcap.reader", "mcap.exceptions", "mcap_ros2.decoder")
_MAGIC = b"\x89MCAP0\r\n"


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
    """Rows of the readings in a file, in the order written, also of one without its end."""
    reader, errors, decoder = optional_modules(path, _MODULES)
    decoders = decoder.DecoderFactory()
    cut = mcap_is_cut(path)
    try:
        with open(path, "rb") as file:
            messages = reader.NonSeekingReader(file, validate_crcs=True)
            for schema, channel, message in messages.iter_messages(log_time_order=False):
                if schema is not None and schema.name == READING:
                    decode = decoders.decoder_for(channel.message_encoding, schema)
                    yield _row(decode(message.data))
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
    stamp = message.header.stamp
    numbers = {name: getattr(message, name) for name in NUMBERS_OF_READING}
    # Not every reading has the y of a surface, and the time of a device.
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
        "time_utc": written_utc(stamp.sec + stamp.nanosec / 1e9 if stamp.sec else None),
    }


# A chunk is written when it holds so much. At 28 readings/s a sensor fills one in a second: what a
# process that is killed loses. Larger ones compress better, and their index takes less memory.
_CHUNK_BYTES = 8_192
# Files in a folder are ended at this size, some seven hours of one sensor: the index of an open
# file takes memory, a quarter of its size.
_FILE_BYTES = 64_000_000


class McapWriter(EndedOutput):
    """Writes readings and health to an MCAP file, or to files of ``most_bytes`` in a folder.

    Messages are logged at the time of their header, the axis of viewers. Where UTC is not known,
    that of the previous message counts, or the time of the reading from 1970 on.
    """

    _items, _kept = "messages", "all messages but those of the last seconds are kept"

    def __init__(
        self,
        path: str | Path,
        inputs: Iterable[str | Path] = (),
        metadata: Mapping[str, str] | None = None,
        sensors: Iterable[str] = (),
        most_bytes: int = _FILE_BYTES,
    ) -> None:
        self._sensors = dict.fromkeys(sensors)
        self._folder = Path(path) if Path(path).is_dir() else None
        if self._folder is None and Path(path).suffix.lower() != ".mcap":
            raise InputError("--mcap", "must be FILE.mcap or an existing folder", str(path))
        super().__init__(_named(self._folder) if self._folder else path, inputs, "MCAP")
        topics_of(self._sensors)
        self._library = optional_module("mcap_ros2.writer", path)
        self._metadata, self._most_bytes = dict(metadata or {}), most_bytes
        self._schemas: dict[str, Any] = {}
        self._utc_ns: int | None = None

    def _writer_of(self, file: OutputFile) -> Any:
        writer = self._library.Writer(file, chunk_size=_CHUNK_BYTES)
        for name in (READING, WRENCH, DIAGNOSTICS):
            self._schemas[name] = writer.register_msgdef(name, complete_definition(name))
        if self._metadata:
            writer.add_metadata("gr-wiforce", self._metadata)
        return writer

    def _write_end(self) -> None:
        self._writer.finish()

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write rows; no two sensors may have the same topics."""
        self.begin()
        for row in rows:
            if row["sensor"] not in self._sensors:
                topics_of([*self._sensors, row["sensor"]])
                self._sensors[row["sensor"]] = None
            for message in reading_messages(row):
                self._put(message, round(row["time_s"] * 1e9))
            self.rows += 1
            if self._folder and self._file and self._file.size_bytes >= self._most_bytes:
                self._begin_next(self._folder)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Write a report once the file is begun; a failure is raised by the next reading."""
        with suppress(OutputError):
            self._put(health_message(report), 0)

    def close(self) -> None:
        """End the file; a run that never began leaves the former one as it was."""
        if self._file is not None:
            super().close()

    def _begin_next(self, folder: Path) -> None:
        with self._lock:
            self.close()
            self._path, self._file, self._writer = _named(folder), None, None
            self.begin()

    def _put(self, message: RosMessage, else_ns: int) -> None:
        with self._lock:
            ended = self._writer is None or self._file is None or self._file.closed
            if ended and self._failure is None:
                return
            self._utc_ns = message.stamp_ns or self._utc_ns
            time_ns = else_ns if self._utc_ns is None else self._utc_ns
            schema, sequence = self._schemas[message.type], self.rows
            with self._writing():
                self._writer.write_message(
                    message.topic, schema, message.fields, time_ns, time_ns, sequence
                )


def _named(folder: Path) -> Path:
    """A file in a folder: names with milliseconds differ, however often a run is started again."""
    now = f"{datetime.now(timezone.utc):%Y%m%dT%H%M%S.%f}"[:-3]
    return folder / f"{now}Z.mcap"
