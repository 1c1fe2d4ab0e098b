# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench``: what the reader reaches, measured; a module per benchmark."""

import click

from ..lazy import LazyGroup

BENCHMARKS = ("accuracy", "speed", "tradeoff", "stress")


@click.command(cls=LazyGroup, package=__package__, names=BENCHMARKS)
def bench():
    """Measure accuracy, speed and limits on this machine."""
