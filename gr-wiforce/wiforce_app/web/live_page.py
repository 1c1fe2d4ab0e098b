# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a live run: an output, and the process of its own that serves it."""

import contextlib
import multiprocessing
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher
from gnuradio.wiforce.io.outputs import Output

from ..shell.workers import end_within, spawned
from .address import OPTION, PageAddress
from .sources import ZmqSource

# The process sends viewers the end of the run before it ends itself. Of a run that ends at once, it
# has to load Bokeh before: 1.5 s, and several times as long on a small or busy machine.
_CLOSE_S = 10.0


class LivePage(Output):
    """Passes readings and health to the process that serves the page.

    By sockets in a folder of this user. A slow process loses messages, and the run goes on.
    """

    def __init__(self, address: PageAddress, warn: Callable[[str], None]):
        self._warn, self._reported = warn, False
        with address.listen() as listening:
            self._folder = tempfile.mkdtemp(prefix="gr-wiforce-page-")
            readings, self.control = (
                f"ipc://{self._folder}/{name}" for name in ("readings", "control")
            )
            try:
                self._publisher = ReadingsPublisher(readings, OPTION)
                # Every user can see arguments, and the address has a token: it is sent, before
                # there is a process, which thus ends in good order even if this one is interrupted
                # or killed. The run lasts as long as this connection.
                self._run, run = multiprocessing.Pipe()
                with run:
                    self._run.send((address, readings, self.control, self._folder))
                    descriptors = listening.fileno(), run.fileno()
                    self._process = spawned(f"{__package__}.live_page", *descriptors)
            except BaseException:
                shutil.rmtree(self._folder, ignore_errors=True)
                raise

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self._publisher.write_rows(rows)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Publish a report, and warn the user when the process has ended."""
        self._publisher.send(kind, report)
        if kind == "end":  # also to a process that does not subscribe yet
            with contextlib.suppress(OSError):
                self._run.send({"message": kind, **report})
        status = self._process.poll()
        if status is not None and not self._reported:
            self._reported = True
            self._warn(f"the page has ended with status {status}; readings go on")

    def close(self) -> None:
        """End the process, after viewers have received the end of the run."""
        self._run.close()
        try:
            end_within(self._process, _CLOSE_S)
        finally:
            self._publisher.close()
            shutil.rmtree(self._folder, ignore_errors=True)


# The process, whose module this is as well. Readings come first where processors are short.
_NICENESS = 10
# For the last readings, after the run has ended.
_LAST_S = 0.5


def main() -> None:
    """Serve the page, with the descriptors of the open port and of the connection."""
    from .server import PageServer, serve_until_signal  # with Bokeh, which takes a second

    os.nice(_NICENESS)
    port, descriptor = map(int, sys.argv[1:3])
    connection = Connection(descriptor)
    address, readings, control, folder = connection.recv()
    source = ZmqSource(readings, control, name="the reader")
    gone_s: float | None = None
    last: dict[str, Any] | None = None

    def ended() -> bool:
        """Whether the run has said that it is over, or its process is gone."""
        nonlocal gone_s, last
        if gone_s is None and connection.poll():
            gone_s = time.monotonic()
            with contextlib.suppress(EOFError, OSError):  # it was killed
                last = connection.recv()
        if gone_s is None or not source.ended and time.monotonic() - gone_s < _LAST_S:
            return False
        source.last = last
        return True

    try:
        with socket.socket(fileno=port) as listening:
            serve_until_signal(lambda: PageServer(source, address, listening), ended, signals=())
    finally:
        # The reader cannot do it when it was killed.
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
