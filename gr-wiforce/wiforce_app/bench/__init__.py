# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench``: what the reader reaches, measured; a module per benchmark."""

import click

from ..lazy import LazyGroup

BENCHMARKS = {
    "accuracy": "Phase error of each estimator against the bound.",
    "speed": "Samples per second of each chain, beside stock blocks.",
    "inversion": "Time per reading of every sensor model.",
    "tradeoff": "Run time against error, over all sensible settings.",
    "stress": "Worst errors at numerical extremes.",
}


@click.command(cls=LazyGroup, package=__package__, helps=BENCHMARKS)
def bench():
    """Measure accuracy, speed and limits on this machine."""
