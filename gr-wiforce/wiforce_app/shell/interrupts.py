# SPDX-License-Identifier: GPL-3.0-or-later
"""Exit statuses, and the end of the command by a signal."""

import signal
from contextlib import contextmanager

DONE = 0
# Any failure that is not the user's: a full disk, a lost device, a fault of the program.
FAILED = 1
# Bad usage or bad input, explained in one line.
BAD_INPUT = 2
# 128 + the number of the signal, as a shell reports a process that a signal ended. SIGPIPE itself
# stays ignored: it would leave a transmitter on and a file incomplete.
INTERRUPTED, TERMINATED, OUTPUT_CLOSED = 130, 143, 141


class Terminated(KeyboardInterrupt):
    """SIGTERM was received; handled like Ctrl-C except for the exit status."""


class Interrupted(Exception):
    """A command was interrupted after it had written what the message says."""


class _Signals:
    """Signal handlers that raise, or wait until files are whole."""

    def __init__(self):
        self._holds = 0
        self._waiting = None

    def receive(self, number, _):
        """Handle a signal; a second SIGTERM ends the process at once."""
        if number == signal.SIGTERM:
            signal.signal(number, signal.SIG_DFL)
        error = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if not self._holds:
            raise error
        self._waiting = error

    @contextmanager
    def uninterrupted(self):
        """A context in the main thread that Ctrl-C and SIGTERM do not interrupt.

        An exception within a library would lose rows. It is raised as the context ends instead,
        unless another exception ends it.
        """
        self._holds += 1
        try:
            yield
        except BaseException:
            self._waiting = None
            raise
        finally:
            self._holds -= 1
        if not self._holds and self._waiting is not None:
            error, self._waiting = self._waiting, None
            raise error


_signals = _Signals()
uninterrupted = _signals.uninterrupted


def _hang_up(number, _):
    signal.signal(number, signal.SIG_IGN)  # the shell sends it, and then the kernel
    signal.raise_signal(signal.SIGTERM)


def interrupt_by_exception():
    """Let Ctrl-C, unless a shell ignores it, and SIGTERM raise exceptions in the main thread.

    A terminal that is closed ends the command as SIGTERM does, unless it runs under nohup.
    """
    signal.signal(signal.SIGTERM, _signals.receive)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, _hang_up)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _signals.receive)
