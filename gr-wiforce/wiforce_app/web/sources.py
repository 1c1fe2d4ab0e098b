# SPDX-License-Identifier: GPL-3.0-or-later
"""What the page shows, and where it is from: a file that grows, or a live reader over ZMQ."""

import csv
import json
import math
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from io import BufferedReader
from itertools import islice
from pathlib import Path
from typing import Any

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files import format_of
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys, endpoint_of
from gnuradio.wiforce.io.optional import optional_module


def loaded(data: bytes | str) -> dict[str, Any]:
    """A JSON object; empty where it is none. Numbers that JSON cannot hold become None."""
    try:
        values = json.loads(data, parse_constant=lambda _: None, parse_float=number)
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def number(value: Any) -> float | None:
    """A finite number from a number or its text; None for anything else."""
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return result if math.isfinite(result) else None


# What the page shows of a heartbeat.
STATUS = ("state", "reason", "scene", "time_s", "tare", "sensors", "surface", "gaps", "groups")
# Whatever the length of a group, so that memory and messages stay small.
_MOST_ROWS = 50_000
# The columns of a row as the page gets it, in this order.
ROW = (
    "sensor",
    "time_s",
    "touch",
    "force_n",
    "force_std_n",
    "location_mm",
    "location_std_mm",
    "snr_db",
    "interference",
    "flags",
    "y_mm",
    "y_std_mm",
    "cov_x_y",
)
_TEXTS = ("sensor", "flags")


def page_row(values: Mapping[str, Any]) -> list[Any] | None:
    """A row of :data:`ROW` from a file or a message; None for what is no reading."""
    row: list[Any] = [
        str(values.get(name) or "") if name in _TEXTS else number(values.get(name)) for name in ROW
    ]
    return row if row[0] and row[1] is not None else None


class PageState:
    """Readings of the last seconds and the latest status, from which viewers catch up."""

    def __init__(self, history_s: float):
        self._history_s = history_s
        self._rows: deque[list[Any]] = deque(maxlen=_MOST_ROWS)
        self._runs, self._count = 0, 0
        self._run: str | None = None
        self._newest: dict[str, float] = {}
        self._arrived: dict[str, float] = {}
        self._status: dict[str, Any] = {}

    @property
    def position(self) -> tuple[int, int]:
        """How far a viewer is that has everything: number of the run, and of the next row."""
        return self._runs, self._count

    def add(self, values: Mapping[str, Any]) -> str | None:
        """Add a reading, and give its sensor; one of another run, or an earlier one, begins anew.

        What is no reading is ignored.
        """
        row = page_row(values)
        if row is None:
            return None
        sensor, time_s = row[0], row[1]
        self.follow(values.get("run"))
        if time_s < self._newest.get(sensor, time_s):
            self._restart()
        self._newest[sensor] = time_s
        self._arrived[sensor] = time.monotonic()
        self._rows.append(row)
        self._count += 1
        while self._rows[0][1] < time_s - self._history_s:
            self._rows.popleft()
        return sensor

    def follow(self, run: str | None) -> None:
        """Begin a new history where another run, if its identifier is known, has begun."""
        if run and run != self._run:
            self._run = run
            self._restart()

    def _restart(self) -> None:
        if self._rows:
            self._runs += 1
        self._rows.clear()
        self._newest.clear()
        self._arrived.clear()

    def show(self, status: Mapping[str, Any]) -> None:
        """Take the status of the source."""
        self._status = dict(status)

    def message(self, position: tuple[int, int], status: bool) -> str:
        """What a viewer lacks as JSON; ``restart`` forgets, as new ones at (-1, 0)."""
        runs, count = position
        kept = self._count - len(self._rows)
        restart = runs != self._runs or count < kept
        rows = list(islice(self._rows, 0 if restart else count - kept, None))
        message: dict[str, Any] = {"restart": restart, "rows": rows}
        if status:
            now = time.monotonic()
            ages = {name: round(now - arrived, 3) for name, arrived in self._arrived.items()}
            message["status"] = {**self._status, "run": self._run, "ages": ages}
        return json.dumps(message, separators=(",", ":"), allow_nan=False)


# Of a long file only the end is read: as many rows as the page keeps take 5 MB.
_TAIL_BYTES = 8 << 20
# Most that one call reads, so that viewers are served meanwhile.
_CHUNK_BYTES = 1 << 20
_NEEDED = ("time_s", "sensor")
# A file without new rows for so long is probably complete: groups last a few seconds at most.
_COMPLETE_S = 10.0


class FileSource:
    """Reads a CSV or JSON lines file that is written meanwhile, absent, replaced or shortened."""

    control = keys = None

    def __init__(self, path: str | Path, now: Callable[[], float] = time.monotonic):
        self._path, self._now, self._grown_s = Path(path), now, now()
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
        if end:
            self._grown_s = self._now()
        for line in data[:end].decode("utf-8", "replace").split("\n"):
            fields = zip(self._columns, [] if self._lines else _fields(line), strict=False)
            values = loaded(line) if self._lines else dict(fields)
            if (sensor := page_state.add(values)) is not None:
                self._sensors.setdefault(sensor, {})
        state, reason = "reading", ""
        if not self._sensors:
            exists = self._path.exists()
            state = "waiting"
            reason = "no readings in the file yet" if exists else "the file does not exist yet"
        elif self._now() - self._grown_s > _COMPLETE_S:
            reason = "the file has stopped growing: point at a curve for its readings"
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
        # The end of the run, once it is certain that it does not come by ZMQ.
        self.last: dict[str, Any] | None = None

    def poll(self, page_state: PageState) -> None:
        """Give the state what has come in."""
        end_s = time.monotonic() + _LONGEST_POLL_S
        for _ in range(_MOST_MESSAGES):
            if not self._subscriber.poll(0) or time.monotonic() > end_s:
                break
            self._take(loaded(self._subscriber.recv()), page_state)
        if self.last is not None and not self.ended:
            self._take(self.last, page_state)
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
