# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts the command: Ctrl-C while the rest is loaded ends it by one line, not by a traceback.

Loading the rest takes longer than typing Ctrl-C. Installed programs import this module first.
"""

import gc
import os
import signal

from .shell.interrupts import INTERRUPTED


def run():
    """Run the command as a process; returns its exit status."""
    # A shell's background command ignores Ctrl-C, and goes on doing so.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    # Or Python would search what it loads for cycles again and again, which takes 10 ms.
    gc.disable()
    from .main import run

    return run()


def _end(*_):
    os.write(2, b"gr-wiforce: interrupted\n")
    os._exit(INTERRUPTED)
