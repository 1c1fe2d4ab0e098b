# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that serves the page of a live run, started by :mod:`live_page`.

Its argument is the descriptor of the open port. Its input begins with a line of settings, and ends
with the run.
"""

import json
import os
import select
import shutil
import signal
import socket
import sys
import time

from .address import PageAddress
from .server import PageServer, serve_until_signal
from .zmq_source import ZmqSource

# Readings come first where processors are short.
_NICENESS = 10
# For the last message, after the input has ended.
_LAST_S = 0.5


class _Run:
    """Whether the run is over: it has said so, or its process is gone."""

    def __init__(self, source: ZmqSource):
        self._source = source
        self._gone_s: float | None = None

    def ended(self) -> bool:
        """Asked at every tick."""
        if self._gone_s is None and select.select([0], [], [], 0)[0] and not os.read(0, 4096):
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
    settings = json.loads(_first_line())
    address = PageAddress(*(settings[key] for key in ("host", "port", "token")))
    source = ZmqSource(settings["readings"], settings["control"], name="the reader")
    run = _Run(source)
    try:
        with socket.socket(fileno=int(sys.argv[1])) as listening:
            serve_until_signal(
                lambda: PageServer(source, address, listening), run.ended, (signal.SIGTERM,)
            )
    finally:
        # The reader cannot do it when it was killed.
        shutil.rmtree(settings["folder"], ignore_errors=True)


def _first_line() -> bytes:
    """Not read through a buffer, which would hide the end of the input from `select`."""
    line = b""
    while not line.endswith(b"\n"):
        line += os.read(0, 4096) or b"\n"
    return line


if __name__ == "__main__":
    main()
