# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of numeric options."""

import math

import click


class FiniteRange(click.FloatRange):
    """A finite float within limits; click's own type accepts nan and inf."""

    def convert(self, value, param, ctx):
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


CARRIER_HZ = FiniteRange(0, 1e12, min_open=True)
