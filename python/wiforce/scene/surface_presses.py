# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses on a surface in a simulation, and the skin that spreads them."""

from typing import Any

from ..io.text.schema import Derived, declared, key
from ..io.text.values import Number

_TIME = Number(unit="s", low=0, high=1e6)
POSITION = Number(unit="mm", low=-10_000, high=10_000)


def _force(scope: Any) -> float:
    force: float = scope["force_n"]
    return force


@declared
class Plate:
    """A skin that acts as a thin plate on an elastic foundation."""

    reach_mm: float = key(
        Number(unit="mm", low=0.5, high=1000),
        default=10.0,
        doc="1/k of the plate: its pressure falls with the distance across as exp(-kd) "
        "(cos kd + sin kd).",
    )
    bearing_mm: float | None = key(
        Number(unit="mm", low=0.1, high=1000, optional=True),
        default=None,
        doc="Width over which a strip bears the plate; null means the median distance of the "
        "strips, so that they bear all of the force.",
    )


@declared
class SurfacePress:
    """A press on the surface; its force over time is that of ``simulation.presses``."""

    start_s: float = key(_TIME, doc="Start of the press, not before `reference_s`.")
    rise_s: float = key(
        _TIME, default=0.1, doc="Time in which the force rises, and falls at the end."
    )
    hold_s: float = key(_TIME, doc="Time in which it is held.")
    force_n: float = key(
        Number(unit="N", low=0, above=True, high=1000), doc="Force after the rise."
    )
    end_force_n: float = key(
        Number(unit="N", low=0, high=1000),
        derived=Derived("`force_n`", _force),
        doc="Force before the fall.",
    )
    x_mm: float = key(POSITION, doc="Where it is along the strips.")
    y_mm: float = key(POSITION, doc="Where it is across.")
    tremor_n: float = key(
        Number(unit="N", low=0, high=100), default=0.0, doc="Rms of a hand's tremor."
    )

    @property
    def end_s(self) -> float:
        """Time at which the force is 0 again, in s."""
        return self.start_s + self.hold_s + 2 * self.rise_s
