# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of force gauges and load cells, and their units."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..io.text.textfile import read_bytes

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
UNITS = "N, mN, kN, g, kg, lb, oz"  # those that are named to users
_TYPED = re.compile(r"([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s*([^\W\d_]*)")
# A sign may stand apart from its number, as in "ST,GS,+  1.234 kg".
_SENT = re.compile(r"([+-]?)\s*(\d+(?:\.\d*)?|\.\d+)\s*([^\W\d_]*)")
# A gauge that sends twice per second may miss two values.
_SILENCE_S = 2.0
# Unsteady force: a standard deviation above this, in N, and above this part of the force. Hand-held
# gauges keep within 2 % (docs/sensors.md).
_UNSTEADY_N, _UNSTEADY_PART = 0.05, 0.03
_KEPT = 4096


def unit_n(unit: str, where: object = "unit") -> float:
    """Newtons of one unit of force or weight, in any case; ``where``: option or prompt."""
    try:
        return UNITS_N[unit.lower()]
    except KeyError:
        raise InputError(where, f"must be one of {UNITS}", unit) from None


def parse_force(text: str) -> float:
    """Force in N of a number that a person typed, with ``.`` or ``,``, and perhaps a unit."""
    match = _TYPED.fullmatch(text.strip())
    if match is None:
        raise InputError("force", "must be a number such as 2.5, or with a unit as in 250 g", text)
    number, named = match.groups()
    return float(number.replace(",", ".")) * unit_n(named or "N", "force")


class ForceGauge:
    """What a gauge sends, line by line, with arrival times; ``unit`` of lines without one."""

    def __init__(self, name: str, unit: str = "N", now_s: float = 0.0) -> None:
        self.name = name
        self._factor = unit_n(unit)
        self._values: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._heard_s = now_s
        self._unread = ""

    def note(self, time_s: float, line: str) -> None:
        """Take a line: its last number that is followed by a unit, or else the last number."""
        found = _SENT.findall(line)
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

    def mean(self, since_s: float, until_s: float) -> tuple[float, float]:
        """Mean force in N of the values that arrived within an interval, and their deviation."""
        values = [force for time_s, force in self._values if since_s <= time_s <= until_s]
        if not values:
            self.check_alive(until_s)
            raise InputError(self.name, "has sent no force during the measurement")
        mean = math.fsum(values) / len(values)
        if len(values) == 1:
            return mean, math.nan
        std = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (len(values) - 1))
        if std > max(_UNSTEADY_N, _UNSTEADY_PART * abs(mean)):
            span = f"{min(values):.2f} to {max(values):.2f} N"
            raise InputError(self.name, "must show a steady force while it is measured", span)
        return mean, std


if TYPE_CHECKING:
    import pandas as pd

# An hour at 10 kHz.
_MAX_BYTES = 1_000_000_000
_TIME = re.compile(r"(?i)(?:time|timestamp|elapsed|date|t)(?:\b|_|$)")
_FORCE = re.compile(r"(?i)(?:force|load|weight|fz?|cell)(?:\b|_|$|\d)")
# A unit in brackets or after the last underscore: "Force (N)", "Load [kgf]", "force_n".
_UNIT = re.compile(r"[(\[{]\s*([^)\]}]+?)\s*[)\]}]\s*$|_([A-Za-z]+)$")
_SECONDS = {
    **{"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    **{"min": 60.0, "minutes": 60.0, "h": 3600.0, "hours": 3600.0},
}
# The largest testing machines reach 1e8 N. Sums and squares of more could overflow.
_MOST_N = 1e12
# Values that are shown for a column that cannot be used.
_SHOWN = 8


@dataclass(frozen=True)
class GaugeRecord:
    """What a gauge recorded (n,), in its own clock, zero and sign."""

    time_s: np.ndarray
    force_n: np.ndarray
    note: str = ""  # what may be wrong with it


def read_gauge(
    record: pd.DataFrame | str | Path,
    time_column: str | None = None,
    force_column: str | None = None,
    unit: str | None = None,
) -> GaugeRecord:
    """Read times and forces from a frame, or a CSV file with a header.

    Commas, semicolons or tabs separate columns, with the latter two decimal commas are allowed.
    Times are seconds, of the unit in the column's name, or ISO 8601. Columns are by default the
    only ones that sound like it; the unit is the column's, else N.
    """
    if isinstance(record, str | Path):
        path, table = str(record), _table(record)
    elif hasattr(record, "to_dict"):
        path, table = "gauge", record
    else:
        rule = "must be a CSV file, a pandas frame or a GaugeRecord"
        raise InputError("gauge", rule, type(record).__name__)
    names = [str(name) for name in table.columns]
    time_name = _column(path, names, time_column, _TIME, "time")
    force_name = _column(path, names, force_column, _FORCE, "force", (time_name,))
    times = _times(path, table[time_name], time_name)
    newtons, note = _newtons(force_name, unit)
    forces = _numbers(path, table[force_name], force_name) * newtons
    if np.nanmax(np.abs(forces), initial=0) > _MOST_N:
        row = int(np.nanargmax(np.abs(forces))) + 2
        raise InputError(f"{path}: row {row}", f"{force_name} must be below {_MOST_N:g} N")
    present = np.isfinite(forces)
    times, forces, rows = times[present], forces[present], np.flatnonzero(present) + 2
    if np.any(np.isnan(times)):
        raise InputError(path, f"{time_name} must be given where there is a force")
    if len(times) < 2:
        raise InputError(path, "must hold two forces or more", len(times))
    if not np.all(np.diff(times) >= 0):
        row = rows[1 + int(np.argmax(np.diff(times) < 0))]
        raise InputError(f"{path}: row {row}", f"{time_name} must not decrease")
    # Some gauges stamp several values with one time: the last one counts.
    last = np.append(np.diff(times) > 0, True)
    if np.sum(last) < 2:
        raise InputError(path, f"{time_name} must increase", times[0])
    return GaugeRecord(times[last], forces[last], note)


def _table(path: str | Path) -> pd.DataFrame:
    import pandas as pd

    data = read_bytes(path, _MAX_BYTES)
    first = data.lstrip(b"\xef\xbb\xbf").split(b"\n", 1)[0]
    separator = chr(max(b",;\t", key=lambda sign: (first.count(sign), sign == ord(","))))
    commas = separator != "," and b"," in data and b"." not in data.split(b"\n", 1)[-1][:4096]
    try:
        with warnings.catch_warnings():
            # Of fields beyond the columns; an empty one behind a last separator is none.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.BytesIO(data),
                sep=separator,
                decimal="," if commas else ".",
                skipinitialspace=True,
                encoding="utf-8-sig",
                index_col=False,
            )
    except pd.errors.ParserWarning as error:
        rule = "rows must not have more fields than there are columns"
        raise InputError(path, rule) from error
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not a CSV file ({str(error).splitlines()[0]})") from error
    table.columns = [str(name).strip() for name in table.columns]
    if table.shape[1] < 2:
        raise InputError(path, "must have columns of times and forces, and a row with their names")
    return table


def _column(
    path: str | Path,
    names: Sequence[str],
    given: str | None,
    pattern: re.Pattern[str],
    kind: str,
    taken: Sequence[str] = (),
) -> str:
    """The name of a column: the one given, or the only one that sounds like it."""
    if given is not None:
        if given not in names:
            rule = f"must be one of the columns of {path}: {', '.join(names[:_SHOWN])}"
            raise InputError(f"--{kind}-column", rule, given)
        return given
    found = [name for name in names if pattern.match(name) and name not in taken]
    if len(found) != 1:
        which = "several columns sound" if found else "no column sounds"
        listed = ", ".join((found or names)[:_SHOWN])
        raise InputError(path, f"{which} like a {kind} ({listed}); state it with --{kind}-column")
    return found[0]


def _unit_of(name: str) -> str:
    match = _UNIT.search(name)
    return "" if match is None else (match[1] or match[2]).strip()


def _newtons(name: str, unit: str | None) -> tuple[float, str]:
    """Newtons of the unit of a column, and a note where that is named after another than stated."""
    named = _unit_of(name)
    known = UNITS_N.get(named.lower())
    if unit is None:
        if named and known is None and name.lower() != f"force_{named.lower()}":
            rule = "names an unknown unit of force; state it with --unit"
            raise InputError(name, rule, named.lower())
        return known or 1.0, ""
    factor = unit_n(unit, "--unit")
    if known in (None, factor):
        return factor, ""
    return factor, f"{name} names the unit {named}, and is read in {unit}, which --unit states"


def _times(path: str | Path, column: pd.Series, name: str) -> np.ndarray:
    """Times in s: numbers, or dates from the first one on."""
    import pandas as pd

    if column.dtype.kind not in "iuf":
        # Seconds may have decimals in some rows only.
        mixed = {} if int(pd.__version__.split(".")[0]) < 2 else {"format": "mixed"}
        dates = pd.to_datetime(column, errors="coerce", utc=True, **mixed)
        if len(dates) and dates.notna().all():
            return ((dates - dates.iloc[0]).dt.total_seconds()).to_numpy()
    times, unit = _numbers(path, column, name), _unit_of(name).lower()
    if unit not in _SECONDS and name.endswith((")", "]", "}")):
        raise InputError(name, f"names an unknown unit of time; known are {', '.join(_SECONDS)}")
    return times * _SECONDS.get(unit, 1.0)


def _numbers(path: str | Path, column: pd.Series, name: str) -> np.ndarray:
    import pandas as pd

    if column.dtype.kind == "b":  # which pandas counts as 0 and 1
        column = column.astype(str)
    numbers = pd.to_numeric(column, errors="coerce")
    wrong = (numbers.isna() & column.notna()) | np.isinf(numbers)
    if wrong.any():
        row = int(np.argmax(wrong.to_numpy())) + 2
        rule = f"{name} must be a finite number"
        raise InputError(f"{path}: row {row}", rule, column[wrong].iloc[0])
    return numbers.to_numpy(float)
