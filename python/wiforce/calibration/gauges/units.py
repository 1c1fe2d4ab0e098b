# SPDX-License-Identifier: GPL-3.0-or-later
"""Forces as people type them and as gauges send them."""

import math
import re
from collections import deque
from typing import NamedTuple

from ...errors import InputError

STANDARD_GRAVITY_M_S2 = 9.80665
_POUND_N = 0.45359237 * STANDARD_GRAVITY_M_S2
# Newtons of one unit. Scales show mass; they are calibrated for standard gravity.
UNITS_N = {
    "n": 1.0,
    "mn": 1e-3,
    "kn": 1e3,
    "g": 1e-3 * STANDARD_GRAVITY_M_S2,
    "gf": 1e-3 * STANDARD_GRAVITY_M_S2,
    "kg": STANDARD_GRAVITY_M_S2,
    "kgf": STANDARD_GRAVITY_M_S2,
    "lb": _POUND_N,
    "lbf": _POUND_N,
    "oz": _POUND_N / 16,
    "ozf": _POUND_N / 16,
}
_TYPED = re.compile(r"([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+))\s*([^\W\d_]*)")
# A sign may stand apart from its number, as in "ST,GS,+  1.234 kg".
_SENT = re.compile(r"([+-]?)\s*(\d+(?:\.\d*)?|\.\d+)\s*([^\W\d_]*)")
# A gauge that sends twice per second may miss two values.
_SILENCE_S = 2.0
# Unsteady force: a standard deviation above this, in N, and above this part of the force. Hand-held
# gauges keep within 2 % (docs/sensors.md).
_UNSTEADY_N, _UNSTEADY_PART = 0.05, 0.03
_KEPT = 4096


def unit_n(unit: str, where: object = "unit") -> float:
    """Newtons of one unit of force, or of the weight of one unit of mass.

    ``unit``: N, mN, kN, g, gf, kg, kgf, lb, lbf, oz or ozf, in any case; ``where``: option or
    prompt, for the message.
    """
    try:
        return UNITS_N[unit.lower()]
    except KeyError:
        raise InputError(where, "must be one of N, mN, g, kg, lb, oz", unit) from None


def parse_force(text: str) -> float:
    """Read a force that a person typed.

    Returns float: in N.

    ``text``: a number, with ``.`` or ``,`` as decimal sign, in N unless a unit follows.
    """
    match = _TYPED.fullmatch(text.strip())
    if match is None:
        raise InputError("force", "must be a number such as 2.5, or with a unit as in 250 g", text)
    number, named = match.groups()
    return float(number.replace(",", ".")) * unit_n(named or "N", "force")


class GaugeForce(NamedTuple):
    """Mean force over an interval.

    ``force_n``, ``std_n``: mean and standard deviation, in N; the latter NaN for a single value;
    ``values``: number of values.
    """

    force_n: float
    std_n: float
    values: int


class ForceGauge:
    """What a gauge or scale sends, line by line, with the times at which it arrived.

    ``name``: of the gauge, for messages; ``unit``: unit of lines that contain none; ``now_s``: time
    at which listening begins.
    """

    def __init__(self, name: str, unit: str = "N", now_s: float = 0.0) -> None:
        self.name = name
        self._factor = unit_n(unit)
        self._values: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._heard_s = now_s
        self._unread = ""

    def note(self, time_s: float, line: str) -> None:
        """Take a line.

        The last number in it that is followed by a unit counts, or else the last number.
        """
        found = [match.groups() for match in _SENT.finditer(line)]
        named = [each for each in found if each[2].lower() in UNITS_N]
        if not found:
            self._unread = line.strip() or self._unread
            return
        sign, number, unit = (named or found)[-1]
        factor = UNITS_N[unit.lower()] if named else self._factor
        self.note_force(time_s, float(sign + number) * factor)

    def note_force(self, time_s: float, force_n: float) -> None:
        """Take a value."""
        if math.isfinite(force_n):
            self._values.append((time_s, force_n))
            self._heard_s, self._unread = time_s, ""

    def heard_since(self, time_s: float) -> bool:
        """Whether a value has arrived after this time."""
        return bool(self._values) and self._values[-1][0] >= time_s

    def check_alive(self, now_s: float) -> None:
        """Check that values still arrive."""
        silence = now_s - self._heard_s
        if silence <= _SILENCE_S:
            return
        if self._unread:
            raise InputError(self.name, "must send a number in each line", self._unread)
        rule = f"has sent no force for {silence:.0f} s; check its cable, power and output mode"
        raise InputError(self.name, rule)

    def mean(self, since_s: float, until_s: float) -> GaugeForce:
        """Mean force of the values that arrived within an interval."""
        values = [force for time_s, force in self._values if since_s <= time_s <= until_s]
        if not values:
            self.check_alive(until_s)
            raise InputError(self.name, "has sent no force during the measurement")
        mean = math.fsum(values) / len(values)
        if len(values) == 1:
            return GaugeForce(mean, math.nan, 1)
        std = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (len(values) - 1))
        if std > max(_UNSTEADY_N, _UNSTEADY_PART * abs(mean)):
            span = f"{min(values):.2f} to {max(values):.2f} N"
            raise InputError(self.name, "must show a steady force while it is measured", span)
        return GaugeForce(mean, std, len(values))
