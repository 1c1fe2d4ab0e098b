# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress bars on a terminal; nothing in a pipe."""

import sys
from contextlib import contextmanager

import click


@contextmanager
def progress(label, length):
    """Give a function to call with the number of steps done since the last call.

    It draws a bar of ``length`` steps on standard error if that is a terminal.
    """
    if not sys.stderr.isatty():
        yield lambda steps: None
        return
    with click.progressbar(length=length, label=label, file=sys.stderr) as bar:
        yield bar.update
