# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench``: benchmarks of the receiver, one module each.

`air` is the channel without samples, which `accuracy` reads under conditions against the bound, and
`stress` at numerical extremes; `chains` are those from samples to tones that are compared with
stock blocks, and the recording that they read.
"""

import click

from ..shell.commands import LazyGroup

BENCHMARKS = {
    "accuracy": (".accuracy", "Compare phase errors with the Cramer-Rao bound."),
    "read": (".read", "Time from a capture's file to readings, and its stages."),
    "live": (".live", "Measure the delay of readings behind the samples."),
    "speed": (".speed", "Measure samples per second, compared with stock blocks."),
    "inversion": (".inversion", "Measure the inversion time of every sensor model."),
    "tradeoff": (".tradeoff", "Compare run time with error for many settings."),
    "stress": (".stress", "Find the worst errors at numerical extremes."),
}


@click.command(cls=LazyGroup, package=__package__, commands=BENCHMARKS)
def bench():
    """Measure accuracy, speed and limits on this machine."""
