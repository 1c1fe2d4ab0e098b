# SPDX-License-Identifier: GPL-3.0-or-later
"""What all viewers are shown: the readings of the last seconds, and the state of their source."""

import json
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

from .messages import LONGEST_TEXT, MOST_SENSORS, number

# Whatever the length of a group, so that memory and messages stay small.
_MOST_ROWS = 50_000
# Of a message, some 200 kB; more follow when it has left. Each viewer that reads slowly holds one.
_MOST_ROWS_SENT = 2000
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
    """A row of the page from a row of a readings file or a message.

    Returns list or None: values in the order of :data:`ROW`, unknown numbers None; None for what is
    no reading.

    ``values``: columns by name; numbers may be text, as in CSV.
    """
    row = [(values.get(name) or "") if name in _TEXTS else number(values.get(name)) for name in ROW]
    texts = [row[ROW.index(name)] for name in _TEXTS]
    if not all(isinstance(each, str) and len(each) <= LONGEST_TEXT for each in texts):
        return None
    return row if row[0] and row[1] is not None else None


class PageState:
    """The readings of the last seconds and the latest status.

    Each viewer remembers how far it has read. A viewer that falls behind catches up from the rows
    that are kept here, so nothing is stored per viewer.

    ``history_s``: seconds of signal that are kept; ``now``: steady time in seconds. ``position``:
    how far a viewer is that has everything: number of the run, and of the next row.
    """

    def __init__(self, history_s: float, now: Callable[[], float] = time.monotonic):
        self._history_s, self._now = history_s, now
        self._rows: deque[list[Any]] = deque(maxlen=_MOST_ROWS)
        self._runs, self._count = 0, 0
        self._run: str | None = None
        self._newest: dict[str, float] = {}
        self._arrived: dict[str, float] = {}
        self._status: dict[str, Any] = {}
        self._texts: dict[tuple[tuple[int, int], bool], str] = {}

    @property
    def position(self) -> tuple[int, int]:
        return self._runs, self._count

    def add(self, values: Mapping[str, Any]) -> None:
        """Add a reading; one of another run, or an earlier one, begins a new history.

        ``values``: as for :func:`page_row`.
        """
        row = page_row(values)
        if row is None:
            return
        sensor, time_s = row[0], row[1]
        self.follow(values.get("run"))
        if sensor not in self._newest and len(self._newest) >= MOST_SENSORS:
            return
        if time_s < self._newest.get(sensor, time_s):
            self._restart()
        self._newest[sensor] = time_s
        self._arrived[sensor] = self._now()
        self._rows.append(row)
        self._count += 1
        while self._rows[0][1] < time_s - self._history_s:
            self._rows.popleft()
        self._texts.clear()

    def follow(self, run: Any) -> None:
        """Begin a new history where another run has begun.

        ``run``: its identifier; anything else where it is not known.
        """
        if isinstance(run, str) and run and (run := run[:LONGEST_TEXT]) != self._run:
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
        now = self._now()
        return {name: round(now - arrived, 3) for name, arrived in self._arrived.items()}

    def show(self, status: Mapping[str, Any]) -> None:
        """Take the status of the source."""
        self._status = dict(status)
        self._texts.clear()

    def message(self, position: tuple[int, int], status: bool) -> str:
        """What a viewer lacks, or the first part of it; made once for all that are equally far.

        Returns str: A JSON object; ``restart`` is true where former rows are to be forgotten.

        ``position``: how far the viewer is; ``(-1, 0)`` for a new one.
        """
        key = (position, status)
        if key not in self._texts:
            restart, first = self._lacking(position)
            rows = list(islice(self._rows, first, first + _MOST_ROWS_SENT))
            message: dict[str, Any] = {"restart": restart, "rows": rows}
            if status:
                message["status"] = {**self._status, "run": self._run, "ages": self.ages()}
            self._texts[key] = json.dumps(message, separators=(",", ":"), allow_nan=False)
        return self._texts[key]

    def position_after(self, position: tuple[int, int]) -> tuple[int, int]:
        """How far a viewer is that gets the message for a position."""
        _, first = self._lacking(position)
        kept = self._count - len(self._rows)
        return self._runs, min(self._count, kept + first + _MOST_ROWS_SENT)

    def _lacking(self, position: tuple[int, int]) -> tuple[bool, int]:
        """Whether a viewer begins anew, and the first row that it lacks."""
        runs, count = position
        kept = self._count - len(self._rows)
        restart = runs != self._runs or count < kept
        return restart, 0 if restart else count - kept
