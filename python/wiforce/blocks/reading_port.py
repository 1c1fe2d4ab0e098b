# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as they leave a block: a callback, and a message each."""

from threading import Event

import pmt

from .. import names


class ReadingPort:
    """Mixed into a block that ends the chain; it implements ``finish``.

    When the stream has ended, ``finish`` publishes the readings of the groups held back.

    Attributes
    ----------
    ended : threading.Event
        Set when the stream has ended and its last group is read.
    """

    def open_port(self, on_reading):
        """Register the message port; ``on_reading`` takes every Reading in the block's thread."""
        self._on_reading = on_reading
        self.ended = Event()
        self.message_port_register_out(pmt.intern(names.READINGS))

    def publish(self, readings):
        for reading in readings:
            if self._on_reading is not None:
                self._on_reading(reading)
            known = {key: value for key, value in reading.row().items() if value is not None}
            self.message_port_pub(pmt.intern(names.READINGS), pmt.to_pmt(known))

    def start(self):
        self.ended.clear()
        return True

    def stop(self):
        self.end()
        return True

    def end(self):
        """Read the groups held back; called by hand where the flowgraph cannot be stopped."""
        try:
            if self.failure is None and not self.ended.is_set():
                self.finish()
        except Exception as error:
            # Raised through the scheduler it would abort the process.
            self.failure = error
        self.ended.set()
