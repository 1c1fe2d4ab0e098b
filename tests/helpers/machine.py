# SPDX-License-Identifier: GPL-3.0-or-later
"""What the machine gives to a test: free ports, a disk that is soon full, time to wait."""

import os
import resource
import secrets
import socket
import sys
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path


def free_ports(count):
    """Ports that nobody listens at, below those that Linux gives to the clients of other tests."""
    ports = []
    with ExitStack() as held:
        while len(ports) < count:
            port = 10_000 + secrets.randbelow(22_768)
            with suppress(OSError):
                held.enter_context(socket.create_server(("127.0.0.1", port)))
                ports.append(port)
    return ports


def free_port():
    return free_ports(1)[0]


def own_address():
    """A loopback address of this process, beside which the same test may run in another one."""
    number = os.getpid()
    return f"127.{64 + (number >> 16)}.{number >> 8 & 255}.{number & 255}"


def wait_until(condition, limit=300, pause_s=0.02, process=None, meanwhile=None):
    """Wait until a condition holds, so many seconds at most; what it has returned then.

    A ``process`` that is given must not end before; ``meanwhile`` is called in between.
    """
    end = time.monotonic() + limit
    while not (result := condition()):
        assert time.monotonic() < end, "not in time"
        assert process is None or process.poll() is None, "the process has ended"
        if meanwhile is not None:
            meanwhile()
        time.sleep(pause_s)
    return result


def children(process):
    """Processes that a process has started, by any of its threads."""
    lists = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(child) for each in lists for child in each.read_text().split()]


def rows_in(path):
    """Rows of a file of readings so far, with the header of CSV."""
    return path.read_text().count("\n") if path.exists() else 0


@contextmanager
def full_disk(size):
    """Within the block, no file of this process may become larger, nor is bytecode written."""
    former, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (former, most))
        sys.dont_write_bytecode = kept


def room_for(size):
    """What a process calls first that may write so many bytes to each file.

    It must not compile what it imports: Python does not check how much of the bytecode could be
    written, so that later processes would fail on its first part.
    """

    def limit():
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit
