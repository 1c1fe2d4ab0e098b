# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers on the command line."""

import math

import click


class FiniteRange(click.FloatRange):
    """A float within limits, as click's own, which lets nan and inf through."""

    def convert(self, value, param, ctx):
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


CARRIER_HZ = FiniteRange(0, 1e12, min_open=True)
