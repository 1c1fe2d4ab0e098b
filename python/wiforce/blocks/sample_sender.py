# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: sends samples with their device tags to another process."""

import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..estimation.groups import Array
from ..io.sample_packets import TAG_KEYS, SampleTag, pack_head
from ..wiforce_python import rx_time_value

_WAIT_S = 0.1
# As far as the system allows: with a larger buffer, the processes wait for each other less often.
_BUFFER_BYTES = 1 << 20
_DONE = -1


class sample_sender(gr.sync_block):
    """Writes complex 16-bit samples and their device tags to a stream socket.

    Parameters
    ----------
    stream : socket.socket
        Connected; a ``sample_receiver`` reads the other end.

    Attributes
    ----------
    sent : int
        Number of samples sent.
    waiting : bool
        The other process is slower than the samples come.
    ended : bool
        Nothing is sent any more.

    Examples
    --------
    >>> ours, theirs = socket.socketpair()
    >>> sample_sender(ours).sent
    0
    """

    def __init__(self, stream: socket.socket) -> None:
        gr.sync_block.__init__(self, "sample_sender", in_sig=[(np.int16, 2)], out_sig=None)
        stream.settimeout(_WAIT_S)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        self._stream = stream
        self.sent = 0
        self.waiting = self.ended = False

    def end(self) -> None:
        """Send nothing any more, not even the rest of a packet."""
        self.ended = True

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        head = pack_head(len(items), self._tags(len(items)))
        data = np.ascontiguousarray(items).view(np.uint8).data.cast("B")
        if not (self._send(memoryview(head)) and self._send(data)):
            self.ended = True
            return _DONE
        self.sent += len(items)
        return len(items)

    def stop(self) -> bool:
        self.ended = True
        return True

    def _tags(self, count: int) -> Iterator[SampleTag]:
        first = self.nitems_read(0)
        for tag in self.get_tags_in_window(0, 0, count):
            key = pmt.symbol_to_string(tag.key)
            if key in TAG_KEYS and (value := _plain(tag.value)) is not None:
                yield SampleTag(key, tag.offset - first, *value)

    def _send(self, data: memoryview) -> bool:
        """Whether all of it was sent."""
        while data and not self.ended:
            try:
                data = data[self._stream.send(data) :]
                self.waiting = False
            except TimeoutError:
                self.waiting = True
            except OSError:  # the other process has gone
                return False
        return not data


def _plain(value: Any) -> tuple[int, float] | None:
    """Whole seconds and fraction of an ``rx_time``, or 0 and a number; None for anything else."""
    if pmt.is_real(value) or pmt.is_integer(value):
        return 0, pmt.to_double(value)
    return rx_time_value(value)
