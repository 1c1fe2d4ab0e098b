# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of readings from a block: a callback and a message port."""

from collections.abc import Callable, Iterable
from threading import Event
from typing import Any

import pmt

from ..io.readings import Reading
from . import names


class ReadingPort:
    """Mix-in of a block that ends the chain and implements ``finish``.

    When the stream has ended, ``finish`` publishes the readings of the groups held back.

    Attributes
    ----------
    ended : threading.Event
        Set when the stream has ended and its last group is read.

    Examples
    --------
    >>> from gnuradio.wiforce.blocks.chain.force_inversion import force_inversion
    >>> issubclass(force_inversion, ReadingPort)
    True
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
