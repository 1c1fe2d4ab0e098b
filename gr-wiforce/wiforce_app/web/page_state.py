# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and status of a live reader or a file, as the page shows them."""

import json
import math
import time
from collections import deque
from collections.abc import Mapping
from itertools import islice
from typing import Any


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

    def add(self, values: Mapping[str, Any]) -> None:
        """Add a reading; one of another run, or an earlier one, begins a new history."""
        row = page_row(values)
        if row is None:
            return
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

    def ages(self) -> dict[str, float]:
        """Seconds since the latest reading of each sensor has arrived."""
        now = time.monotonic()
        return {name: round(now - arrived, 3) for name, arrived in self._arrived.items()}

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
            message["status"] = {**self._status, "run": self._run, "ages": self.ages()}
        return json.dumps(message, separators=(",", ":"), allow_nan=False)
