# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that serves the page of a live run, started by :mod:`live_page`.

Its arguments are the descriptors of the open port and of a connection, on which it is told what to
serve and which lasts as long as the run.
"""

import os
import shutil
import signal
import socket
import sys
import time
from multiprocessing.connection import Connection

from .server import PageServer, serve_until_signal
from .zmq_source import ZmqSource

# Readings come first where processors are short.
_NICENESS = 10
# For the last message, after the run has ended.
_LAST_S = 0.5


class _Run:
    """Whether the run is over: it has said so, or its process is gone."""

    def __init__(self, source: ZmqSource, connection: Connection):
        self._source, self._connection = source, connection
        self._gone_s: float | None = None

    def ended(self) -> bool:
        """Asked at every tick."""
        if self._gone_s is None and self._connection.poll():
            self._gone_s = time.monotonic()
        if self._gone_s is None:
            return False
        late = time.monotonic() - self._gone_s > _LAST_S
        if late and not self._source.ended:
            self._source.give_up("the reader's process has ended without a word")
        return late or self._source.ended


def main() -> None:
    """Serve the page."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run ends first, and then the page
    os.nice(_NICENESS)
    port, descriptor = map(int, sys.argv[1:3])
    connection = Connection(descriptor)
    address, readings, control, folder = connection.recv()
    source = ZmqSource(readings, control, name="the reader")
    run = _Run(source, connection)
    try:
        with socket.socket(fileno=port) as listening:
            serve_until_signal(
                lambda: PageServer(source, address, listening), run.ended, (signal.SIGTERM,)
            )
    finally:
        # The reader cannot do it when it was killed.
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
