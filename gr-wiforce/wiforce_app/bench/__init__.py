# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench``: benchmarks of the receiver, one module each."""

import click

from ..lazy import LazyGroup

BENCHMARKS = {
    "accuracy": "Compare phase errors with the Cramer-Rao bound.",
    "read": "Time from a capture's file to readings, and its stages.",
    "live": "Measure the delay of readings behind the samples.",
    "speed": "Measure samples per second, compared with stock blocks.",
    "inversion": "Measure the inversion time of every sensor model.",
    "tradeoff": "Compare run time with error for many settings.",
    "stress": "Find the worst errors at numerical extremes.",
}


@click.command(cls=LazyGroup, package=__package__, helps=BENCHMARKS)
def bench():
    """Measure accuracy, speed and limits on this machine."""
