# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of long work: a bar on a terminal, nothing in a pipe."""

import sys
from contextlib import contextmanager

import click


@contextmanager
def progress(label, length):
    """A function that takes how many more of ``length`` steps are done.

    Draws a bar on standard error when that is a terminal; does nothing otherwise.
    """
    if not sys.stderr.isatty():
        yield lambda steps: None
        return
    with click.progressbar(length=length, label=label, file=sys.stderr) as bar:
        yield bar.update
