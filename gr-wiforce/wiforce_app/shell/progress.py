# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress bars on a terminal; nothing in a pipe."""

import sys
from contextlib import contextmanager

import click


def rows_on_terminal(output):
    """Whether the rows of an output appear on a terminal, where they would cut a line in two."""
    return output is None and sys.stdout.isatty()


@contextmanager
def progress(label, length, shown=True):
    """Give a function that takes the steps done since its last call, and draws a bar of them."""
    if not (shown and sys.stderr.isatty()):
        yield lambda steps: None
        return
    with click.progressbar(length=length, label=label, file=sys.stderr) as bar:
        yield bar.update
