# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of an MCAP file, also of one whose end is missing."""

import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..optional import optional_modules
from ..readings import NUMBERS
from ..ros_messages import READING, fields_of
from ..utc import written_utc

_MODULES = ("mcap.stream_reader", "mcap.exceptions", "mcap.records", "mcap_ros2.decoder")
_MAGIC = b"\x89MCAP0\r\n"
# Numbers that not every reading has: y of a surface, and the time of a device.
_FURTHER = tuple(
    name
    for name, (kind, _) in fields_of(READING).items()
    if kind == "float64" and name not in NUMBERS
)


def mcap_rows(path: str | Path) -> Iterator[dict[str, Any]]:
    """Rows of the readings in a file, in the order in which they were written.

    The index of the file is not needed, so all complete chunks of a file are read that a killed
    process has left.

    Yields dict: columns of a reading, ``run`` and ``time_utc``; where known, ``device_time_s`` and
    the y of a press on a surface.

    Raises
    ------
    InputError
        When mcap-ros2-support is missing, or the file is not MCAP or cannot be read.
    """
    stream, errors, records, decoder = optional_modules(path, _MODULES)
    decoders = decoder.DecoderFactory()
    schemas: dict[int, Any] = {}
    decoder_of: dict[int, Any] = {}
    complete = False
    try:
        with open(path, "rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise InputError(path, "is not an MCAP file")
            file.seek(-len(_MAGIC), os.SEEK_END)
            complete = file.read() == _MAGIC and file.tell() > len(_MAGIC)
            file.seek(0)
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
        if complete:
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
