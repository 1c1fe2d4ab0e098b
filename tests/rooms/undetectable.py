# SPDX-License-Identifier: GPL-3.0-or-later
"""Mistakes and effects that leave little or no trace in what is received.

They are not rooms in which the reader is to give no wrong reading: what is measured is how large
the errors are, and how often they are noticed, by ``score.py --room undetectable``.
"""

from dataclasses import dataclass, replace

import numpy as np
from second_simulator import Line, pressed

from rooms import reflections
from rooms.effects import Effect, Switches, UntouchedTag


@dataclass
class OtherLine(Effect):
    """The sensor that is pressed is not the one of the file; its cables are the same."""

    line: Line

    def alter_tag(self, tag, rng):
        tag.tag = replace(tag.tag, line=self.line)


@dataclass
class OffState(Effect):
    """Open switches reflect this share of what an end does; the scene does not state it."""

    level: float

    def alter_tag(self, tag, rng):
        tag.tag = replace(tag.tag, off=self.level * np.exp(2j * np.pi * rng.random()))


@dataclass
class SynchronousTag(UntouchedTag):
    """A tag whose switches run on the clock of ours, a part of a period later."""

    level_db: float
    later_s: float = 0.0  # of its path
    later_cycles: float = 0.0  # of its clock

    def begin(self, air, rng):
        self.switches = Switches(air.tag.switches.clock_hz)
        self.switches.cycles = air.tag.switches.cycles - self.later_cycles
        self.ends = np.exp(2j * np.pi * rng.random(2))
        self.arrive(air, self.later_s)


@dataclass
class PushedSensor(Effect):
    """Every press pushes the sensor away from the antennas, in proportion to its force."""

    mm: float  # at 5 N

    def begin(self, air, rng):
        force = pressed(air.tag.tag, air.edges_s)[0]
        moved_deg = np.degrees(reflections.RAD_PER_M) * 1e-3 * self.mm * force / 5.0
        air.tag.drift_deg -= moved_deg[:, None]


# The line that was calibrated, and the effect.
LEANING = Line(lean=0.2)  # shorted 20 % further towards port 1
CASES = {
    "swapped": (Line(), OtherLine(Line(swapped=True))),
    "swapped-leaning": (LEANING, OtherLine(replace(LEANING, swapped=True))),
}
CASES |= {
    f"file-{name}": (Line(), OtherLine(line))
    for name, line in (
        ("10%", Line(width_mm=1.9)),  # the short is so much narrower
        ("stiff", Line(width_mm=1.05)),
        ("soft", Line(width_mm=4.2)),
        ("leaning", LEANING),
        ("78mm", Line(length_mm=78.0)),
        ("75mm", Line(length_mm=75.0)),
        ("85mm", Line(length_mm=85.0)),
        ("100mm", Line(length_mm=100.0)),
        ("permittivity", Line(permittivity=1.5)),
    )
}
CASES |= {
    f"tag{level:+d}{name}": (Line(), SynchronousTag(level, **how))
    for level in (-30, -20, -10)
    for name, how in (
        ("", {}),
        ("-late", {"later_s": 20e-9}),
        ("-quarter", {"later_cycles": 0.25}),
    )
}
CASES |= {f"off-{level:g}": (Line(), OffState(level)) for level in (0.02, 0.05, 0.1, 0.3)}
CASES |= {
    f"near-hand{level:+d}": (Line(), reflections.HandPath(level)) for level in (-40, -30, -20, -10)
}
CASES |= {f"pushed-{mm:g}mm": (Line(), PushedSensor(mm)) for mm in (0.1, 0.3, 1.0, 3.0)}
