# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: sends samples with their device tags to another process."""

import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.groups import Array
from ...io.network.sample_packets import TAG_KEYS, SampleTag, pack_head
from ...wiforce_python import rx_time_value
from .. import names
from ..argument_types import typed
from ..kept import Kept

_WAIT = struct.pack("@ll", 0, 100_000)  # a timeval, 0.1 s
# As far as the system allows: with a larger buffer, the processes wait for each other less often.
_BUFFER_BYTES = 1 << 20
_DONE = -1


class sample_sender(Kept, gr.sync_block):
    """Writes complex 16-bit samples and their device tags to a stream socket.

    Parameters
    ----------
    stream : socket.socket
        Connected; a ``sample_receiver`` reads the other end.
    interval_s : float
        Time from one packet to the next, at least. What arrives meanwhile is sent together: the
        processor time of both processes depends on the number of packets.
    accepts_time : callable, optional
        Whether a time in seconds is sent as ``rx_time``; all are by default.
    antennas : int
        Number of inputs; their samples are sent side by side.

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

    @typed
    def __init__(
        self,
        stream: socket.socket,
        interval_s: float = 0.0,
        accepts_time: Callable[[float], bool] = lambda seconds: True,
        antennas: int = 1,
    ) -> None:
        signature = [(np.int16, 2)] * antennas
        gr.sync_block.__init__(self, "sample_sender", in_sig=signature, out_sig=None)
        # With a timeout of Python's, a call would send whatever part finds room at once.
        stream.settimeout(None)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _WAIT)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        self._stream, self._interval_s = stream, interval_s
        self._accepts_time = accepts_time
        self._next_s = 0.0
        self.sent = 0
        self.waiting = self.ended = False

    def end(self) -> None:
        """Send nothing any more, not even the rest of a packet."""
        self.ended = True

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        if len(input_items) > 1:
            items = np.concatenate(input_items, axis=1)
        head = pack_head(len(items), self._tags(len(items)))
        data = np.ascontiguousarray(items).view(np.uint8).data.cast("B")
        if not self._send([memoryview(head), memoryview(data)]):
            self.ended = True
            return _DONE
        self.sent += len(items)
        early_s = self._next_s - time.monotonic()
        if early_s > 0:
            time.sleep(early_s)
        self._next_s = time.monotonic() + self._interval_s
        return len(items)

    def stop(self) -> bool:
        self.ended = True
        return True

    def _tags(self, count: int) -> Iterator[SampleTag]:
        first = self.nitems_read(0)
        for tag in self.get_tags_in_window(0, 0, count):
            key = pmt.symbol_to_string(tag.key)
            if key not in TAG_KEYS or (value := _plain(tag.value)) is None:
                continue
            if key != names.RX_TIME or self._accepts_time(sum(value)):
                yield SampleTag(key, tag.offset - first, *value)

    def _send(self, parts: list[memoryview]) -> bool:
        """Whether all of it was sent."""
        while parts and not self.ended:
            try:
                count = self._stream.sendmsg(parts)
                self.waiting = False
            except BlockingIOError:
                self.waiting = True
                continue
            except OSError:  # the other process has gone
                return False
            while parts and count >= len(parts[0]):
                count -= len(parts.pop(0))
            if parts:
                parts[0] = parts[0][count:]
        return not parts


def _plain(value: Any) -> tuple[int, float] | None:
    """Whole seconds and fraction of an ``rx_time``, or 0 and a number; None for anything else."""
    if pmt.is_real(value) or pmt.is_integer(value):
        return 0, pmt.to_double(value)
    return rx_time_value(value)
