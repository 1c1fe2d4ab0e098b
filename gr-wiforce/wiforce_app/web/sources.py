# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the page has its readings from: a file that grows, or a live reader over ZMQ."""

import csv
import os
import time
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from typing import Any

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files import format_of
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys, endpoint_of
from gnuradio.wiforce.io.optional import optional_module

from .page_state import STATUS, PageState, loaded, page_row

# Of a long file only the end is read: as many rows as the page keeps take 5 MB.
_TAIL_BYTES = 8 << 20
# Most that one call reads, so that viewers are served meanwhile.
_CHUNK_BYTES = 1 << 20
_NEEDED = ("time_s", "sensor")


class FileSource:
    """Reads a CSV or JSON lines file that is written meanwhile, absent, replaced or shortened."""

    control = keys = None

    def __init__(self, path: str | Path):
        self._path = Path(path)
        form = format_of(path)
        if form is None or not form.text:
            raise InputError(path, "must be a file .csv or .jsonl, or a ZMQ endpoint tcp://...")
        self._lines = form.suffix == ".jsonl"
        self._identity: tuple[int, int] | None = None
        self._columns: list[str] = []
        self._offset = 0
        self._sensors: dict[str, dict[str, Any]] = {}
        self._read(0)

    def poll(self, page_state: PageState) -> None:
        """Give the state what the file holds by now."""
        data = self._read(_CHUNK_BYTES)
        # A chunk without an end of a line is no row of readings.
        end = data.rfind(b"\n") + 1 or len(data) // _CHUNK_BYTES * _CHUNK_BYTES
        self._offset += end
        for line in data[:end].decode("utf-8", "replace").split("\n"):
            fields = zip(self._columns, [] if self._lines else _fields(line), strict=False)
            values = loaded(line) if self._lines else dict(fields)
            if (row := page_row(values)) is not None:
                page_state.add(values)
                self._sensors.setdefault(row[0], {})
        state, reason = "reading", ""
        if not self._sensors:
            exists = self._path.exists()
            state = "waiting"
            reason = "no readings in the file yet" if exists else "the file does not exist yet"
        status = {"state": state, "reason": reason, "sensors": self._sensors}
        page_state.show({"source": self._path.name, "can_tare": False, **status})

    def close(self) -> None:
        """No file stays open."""

    def _read(self, most: int) -> bytes:
        """What follows in the file, at most so many bytes; of another file, from its start on."""
        try:
            with open(self._path, "rb") as file:
                found = os.fstat(file.fileno())
                identity = found.st_dev, found.st_ino
                if identity != self._identity or found.st_size < self._offset:
                    self._identity = identity if self._begin(file, found.st_size) else None
                file.seek(self._offset)
                return file.read(most if self._identity else 0)
        except FileNotFoundError:
            return b""
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})") from error

    def _begin(self, file: BufferedReader, size_bytes: int) -> bool:
        """Find columns and first row to read; False while the line of the columns is incomplete."""
        if not self._lines:
            line = file.readline(_CHUNK_BYTES)
            if not line.endswith(b"\n"):
                return False
            self._columns = _fields(line.decode("utf-8", "replace").strip())
            if missing := [name for name in _NEEDED if name not in self._columns]:
                raise InputError(self._path, f"must hold readings, but has no column {missing[0]}")
        if size_bytes - _TAIL_BYTES > file.tell():
            file.seek(size_bytes - _TAIL_BYTES)
            file.readline()  # the rest of a row
        self._offset = file.tell()
        return True


def _fields(line: str) -> list[str]:
    """Fields of a line of CSV; none where it is damaged."""
    try:
        return next(csv.reader([line]), [])
    except csv.Error:
        return []


# Heartbeats come every 0.5 s; after four that are missing, the reader counts as lost.
_SILENT_S = 2.0
# Most messages that one call takes, so that viewers are served meanwhile.
_MOST_MESSAGES = 2000
_LONGEST_POLL_S = 0.05
# ZMQ keeps up to 1000 messages that wait. A heartbeat has 150 bytes for each sensor.
_LONGEST_MESSAGE = 64 << 10


class ZmqSource:
    """Subscribes to a live reader at ``readings``, which takes requests at ``control``."""

    def __init__(
        self,
        readings: str,
        control: str | None = None,
        keys: ClientKeys | None = None,
        name: str | None = None,
        now: Callable[[], float] = time.monotonic,
    ):
        zmq = optional_module("zmq", "SOURCE")
        self._now, self.keys, self._name = now, keys, name or readings
        self.control = None if control is None else endpoint_of(control, "--control")
        endpoint = endpoint_of(readings, "SOURCE")
        self._context = zmq.Context()
        self._subscriber = self._context.socket(zmq.SUB)
        self._subscriber.setsockopt(zmq.MAXMSGSIZE, _LONGEST_MESSAGE)
        self._subscriber.subscribe("")
        if keys is not None:
            keys.apply(self._subscriber)
        try:
            self._subscriber.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise InputError("SOURCE", f"cannot be connected to ({error})", readings) from error
        self._heard_s: float | None = None
        self._shown: dict[str, Any] = {"state": "waiting", "sensors": {}}
        self.ended = False

    def poll(self, page_state: PageState) -> None:
        """Give the state what has come in."""
        end_s = time.monotonic() + _LONGEST_POLL_S
        for _ in range(_MOST_MESSAGES):
            if not self._subscriber.poll(0) or time.monotonic() > end_s:
                break
            self._take(loaded(self._subscriber.recv()), page_state)
        page_state.show(self._status())

    def close(self) -> None:
        """Give the socket back."""
        self._subscriber.close(linger=0)
        self._context.term()

    def _take(self, message: dict[str, Any], page_state: PageState) -> None:
        kind = message.get("message")
        if kind not in ("reading", "heartbeat", "end"):
            return
        self._heard_s = self._now()
        self.ended = kind == "end"
        if kind == "reading":
            page_state.add(message)
            return
        page_state.follow(message.get("run"))
        self._shown = {key: message[key] for key in STATUS if key in message}

    def _status(self) -> dict[str, Any]:
        status = {**self._shown, "source": self._name, "can_tare": self.control is not None}
        if self._heard_s is None:
            status["reason"] = f"no messages from {self._name} yet"
        elif not self.ended and (silent_s := self._now() - self._heard_s) > _SILENT_S:
            reason = f"no messages for {silent_s:.0f} s: the reader or its network is down"
            status |= {"state": "lost", "reason": reason}
        elif status.get("state", "waiting") == "waiting" and not status.get("reason"):
            status["state"] = "reading"  # a publisher of readings without heartbeats
        return status
