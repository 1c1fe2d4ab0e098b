# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a live run: an output that a process of its own shows (:mod:`page_process`)."""

import contextlib
import multiprocessing
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher
from gnuradio.wiforce.io.outputs import Output

from ..shell.processes import spawned
from .address import OPTION, PageAddress

# The process sends viewers the end of the run before it ends itself.
_CLOSE_S = 3.0


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
            except Exception:
                shutil.rmtree(self._folder, ignore_errors=True)
                raise
            # Every user can see arguments, and the address has a token: it is sent. The run lasts
            # as long as this connection.
            self._run, run = multiprocessing.Pipe()
            with run:
                descriptors = listening.fileno(), run.fileno()
                self._process = spawned(f"{__package__}.page_process", *descriptors)
        with contextlib.suppress(OSError):  # it has ended already, which is reported
            self._run.send((address, readings, self.control, self._folder))

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self._publisher.write_rows(rows)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Publish a report, and warn the user when the process has ended."""
        self._publisher.send(kind, report)
        status = self._process.poll()
        if status is not None and not self._reported:
            self._reported = True
            self._warn(f"the page has ended with status {status}; readings go on")

    def close(self) -> None:
        """End the process, after viewers have received the end of the run."""
        self._run.close()
        try:
            self._process.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._publisher.close()
        shutil.rmtree(self._folder, ignore_errors=True)
