# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as messages of a block, and as streams of numbers."""

import time
from collections import deque
from collections.abc import Callable, Iterable
from threading import Event
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.groups import Array
from ..io.readings import Reading, as_reading
from . import names
from .argument_types import Kept, typed


class ReadingPort:
    """Mix-in of a block that ends the chain and implements ``finish``.

    When the stream has ended, ``finish`` publishes the readings of the groups held back; ``ended``
    is set when the last group is read.
    """

    failure: Exception | None
    message_port_register_out: Callable[[Any], None]
    message_port_pub: Callable[[Any, Any], None]

    def open_port(self, on_reading: Callable[[Reading], None] | None) -> None:
        """Register the message port; ``on_reading`` takes every Reading in the block's thread."""
        self._on_reading = on_reading
        self.ended = Event()
        self.message_port_register_out(pmt.intern(names.READINGS))

    def finish(self) -> None:
        """Publish the readings that are held back."""
        raise NotImplementedError

    def publish(self, readings: Iterable[Reading]) -> None:
        """Send readings to the callback and the message port."""
        for reading in readings:
            if self._on_reading is not None:
                self._on_reading(reading)
            known = {key: value for key, value in reading.row().items() if value is not None}
            self.message_port_pub(pmt.intern(names.READINGS), pmt.to_pmt(known))

    def start(self) -> bool:
        self.ended.clear()
        return bool(super().start())  # type: ignore[misc]

    def stop(self) -> bool:
        self.end()
        return True

    def end(self) -> None:
        """Read the groups held back; called by hand where the flowgraph cannot be stopped."""
        try:
            if self.failure is None and not self.ended.is_set():
                self.finish()
        except Exception as error:
            # Raised through the scheduler it would abort the process.
            self.failure = error
        self.ended.set()


_COLUMNS = ("force_n", "force_std_n", "location_mm", "location_std_mm")
# Readings that wait for a flowgraph that is blocked: several minutes of them.
_MOST_WAITING = 10_000
# Messages are handled between two calls of work(), so it may wait for a short time only. Far
# below the length of a group, and long enough to cost no processor time.
_PAUSE_S = 0.005


class readings_to_floats(Kept, gr.sync_block):
    """Puts the force and the location of a sensor, and their uncertainty, into float streams.

    Message port ``readings`` (in): dicts as ``reader`` and ``force_inversion`` give them. Outputs:
    four float streams, ``force_n``, ``force_std_n`` (N), ``location_mm`` and ``location_std_mm``
    (mm), with ``repeat`` items per reading. The force of an untouched sensor is 0 N; values
    that a reading does not have are ``unknown``.

    Parameters
    ----------
    sensor : str
        Name of the sensor; empty for the sensor of the first reading.
    repeat : int
        Items per reading, 1 or more.
    flagged : bool
        False gives ``unknown`` for readings with a flag other than ``reference``.
    unknown : float
        Value where the reading has none.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> floats = readings_to_floats(sensor="arm", repeat=4)
    """

    @typed
    def __init__(
        self,
        sensor: str = "",
        repeat: int = 1,
        flagged: bool = True,
        unknown: float = np.nan,
    ) -> None:
        if repeat < 1:
            raise InputError("repeat", "must be 1 or more", repeat)
        gr.sync_block.__init__(self, "readings_to_floats", None, [np.float32] * len(_COLUMNS))
        self._sensor = sensor
        self._flagged = flagged
        self._unknown = unknown
        self._waiting: deque[list[float]] = deque(maxlen=_MOST_WAITING)
        self.set_output_multiple(repeat)
        self._repeat = repeat
        self.message_port_register_in(pmt.intern(names.READINGS))
        self.set_msg_handler(pmt.intern(names.READINGS), self._on_reading)

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        if not self._waiting:
            time.sleep(_PAUSE_S)
            return 0
        count = min(len(self._waiting), len(output_items[0]) // self._repeat)
        rows = np.array([self._waiting.popleft() for _ in range(count)], np.float32)
        for out, column in zip(output_items, rows.T, strict=True):
            out[: count * self._repeat] = np.repeat(column, self._repeat)
        return count * self._repeat

    def _on_reading(self, message: Any) -> None:
        reading = as_reading(pmt.to_python(message)) if pmt.is_dict(message) else None
        if reading is None:
            return
        self._sensor = self._sensor or reading.sensor
        if reading.sensor == self._sensor:
            self._waiting.append(self._values(reading))

    def _values(self, reading: Reading) -> list[float]:
        if set(reading.flags) - {"reference"} and not self._flagged:
            return [self._unknown] * len(_COLUMNS)
        if reading.touch == 0:
            return [0.0, *[self._unknown] * (len(_COLUMNS) - 1)]
        values = [getattr(reading, name) for name in _COLUMNS]
        return [self._unknown if value is None else value for value in values]
