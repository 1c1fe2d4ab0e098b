# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages, their pace, and progress bars on standard error, for a terminal or a journal."""

import contextlib
import math
import os
import sys
from collections.abc import Callable
from functools import partialmethod

import click
from gnuradio.wiforce.errors import printable

PROGRAM = "gr-wiforce"
# The names that users give, and syslog's numbers, which the journal reads at the start of a line.
LEVELS = {"error": 3, "warning": 4, "info": 6, "debug": 7}
FORMATS = ("auto", "plain", "journal")


class Log:
    """Writes messages, one line each."""

    level = "info"  # below which messages are not written
    journal = False  # lines begin with the number of their level, as <4>
    line_in_use = False  # a status line is on the terminal, which a message replaces

    def set_up(self, level: str = "info", form: str = "auto") -> None:
        """Choose the least level of ``LEVELS``, and one of ``FORMATS``."""
        self.level = level
        self.journal = form == "journal" or form == "auto" and is_journal()

    def write(self, level: str, text: str) -> None:
        """Write one message; a standard error that cannot be written to is no failure."""
        if LEVELS[level] > LEVELS[self.level]:
            return
        if self.journal:
            line = f"<{LEVELS[level]}>{printable(text)}"
        else:
            kind = f"{level}: " if level in ("warning", "debug") else ""
            line = f"{PROGRAM}: {kind}{printable(text)}"
        start = "\r\033[K" if self.line_in_use else ""
        with contextlib.suppress(OSError):
            click.echo(start + line, err=True)

    error = partialmethod(write, "error")  # what ends the program
    warning = partialmethod(write, "warning")  # what makes readings worse, or may soon
    info = partialmethod(write, "info")  # what happened in normal operation
    debug = partialmethod(write, "debug")  # details for the search of an error


def is_journal() -> bool:
    """Whether standard error goes to systemd's journal."""
    stated = os.environ.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return stated == f"{status.st_dev}:{status.st_ino}"


log = Log()
_SHORTEST_S, _LONGEST_S = 1.0, 600.0


class WarningPace:
    """Allows a kind of warning, after pauses that double from 1 s to 10 min while it goes on."""

    def __init__(self, now: Callable[[], float]):
        self._now = now
        self._last_s: dict[str, float] = {}
        self._pause_s: dict[str, float] = {}

    def allows(self, kind: str) -> bool:
        """Whether a warning that is due may be written now; if so, it counts as written."""
        now, pause_s = self._now(), self._pause_s.get(kind, 0.0)
        quiet_s = now - self._last_s.get(kind, -math.inf)
        if quiet_s < pause_s:
            return False
        longer = quiet_s < 2 * max(pause_s, _SHORTEST_S)
        self._pause_s[kind] = min(2 * pause_s, _LONGEST_S) if longer and pause_s else _SHORTEST_S
        self._last_s[kind] = now
        return True


def rows_on_terminal(outputs):
    """Whether the rows of outputs appear on a terminal, where they would cut a line in two."""
    return not outputs and sys.stdout.isatty()


@contextlib.contextmanager
def progress(label, length, shown=True):
    """Give a function that takes the steps done since its last call, and draws a bar of them."""
    if not (shown and sys.stderr.isatty()):
        yield lambda steps: None
        return
    with click.progressbar(length=length, label=label, file=sys.stderr) as bar:
        yield bar.update
