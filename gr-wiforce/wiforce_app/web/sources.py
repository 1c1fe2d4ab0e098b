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
from gnuradio.wiforce.io.network.zmq_keys import ClientKeys
from gnuradio.wiforce.io.network.zmq_sockets import endpoint_of
from gnuradio.wiforce.io.optional import optional_module

from .page_state import STATUS, PageState, loaded, page_row

# Of a long file only the end is read: as many rows as the page keeps take 5 MB.
_TAIL_BYTES = 8 << 20
# Most that one call reads, so that viewers are served meanwhile.
_CHUNK_BYTES = 1 << 20
_LONGEST_ROW = 100_000
_NEEDED = ("time_s", "sensor")


class FileSource:
    """Reads a CSV or JSON lines file that is written meanwhile, absent, replaced or shortened."""

    def __init__(self, path: str | Path):
        self._path = Path(path)
        self.control = self.keys = None
        form = format_of(path)
        if form is None or not form.text:
            raise InputError(path, "must be a file .csv or .jsonl, or a ZMQ endpoint tcp://...")
        self._lines = form.suffix == ".jsonl"
        self._file: BufferedReader | None = None
        self._columns: list[str] = []
        self._rest = b""
        self._sensors: dict[str, dict[str, Any]] = {}
        self._open()

    def poll(self, page_state: PageState) -> None:
        """Give the state what the file holds by now."""
        if data := b"" if self._file is None else self._file.read(_CHUNK_BYTES):
            *lines, self._rest = (self._rest + data).split(b"\n")
            if len(self._rest) > _LONGEST_ROW:  # no file of readings
                self._rest = b""
            for line in lines:
                self._take(line.decode("utf-8", "replace"), page_state)
        elif self._is_replaced():
            self._open()
        page_state.show(self._status())

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _open(self) -> None:
        self.close()
        self._columns, self._rest = [], b""
        try:
            self._file = open(self._path, "rb")
        except FileNotFoundError:
            return
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})") from error
        if not self._lines:
            self._take_header()
        start = os.fstat(self._file.fileno()).st_size - _TAIL_BYTES
        if start > self._file.tell():
            self._file.seek(start)
            self._file.readline()  # the rest of a row

    def _take_header(self) -> None:
        """The columns; a file that is just being created may have no complete first line."""
        assert self._file is not None
        line = self._file.readline(_CHUNK_BYTES)
        if not line.endswith(b"\n"):
            self._file.seek(0)
            return
        self._columns = _fields(line.decode("utf-8", "replace").strip())
        if missing := [name for name in _NEEDED if name not in self._columns]:
            raise InputError(self._path, f"must hold readings, but has no column {missing[0]}")

    def _take(self, line: str, page_state: PageState) -> None:
        if not self._lines and not self._columns:
            self._columns = _fields(line.strip())
            return
        columns = self._columns
        values = loaded(line) if self._lines else dict(zip(columns, _fields(line), strict=False))
        if (row := page_row(values)) is not None:
            page_state.add(values)
            self._sensors.setdefault(row[0], {})

    def _is_replaced(self) -> bool:
        try:
            found = os.stat(self._path)
        except OSError:
            return False
        if self._file is None:
            return True
        opened = os.fstat(self._file.fileno())
        same = (found.st_dev, found.st_ino) == (opened.st_dev, opened.st_ino)
        return not same or found.st_size < self._file.tell()

    def _status(self) -> dict[str, Any]:
        state, reason = "reading", ""
        if self._file is None:
            state, reason = "waiting", "the file does not exist yet"
        elif not self._sensors:
            state, reason = "waiting", "no readings in the file yet"
        status = {"state": state, "reason": reason, "sensors": self._sensors}
        return {"source": self._path.name, "can_tare": False, **status}


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
