# SPDX-License-Identifier: GPL-3.0-or-later
"""The frequency of the mains, as a type of value in scene files."""

from dataclasses import dataclass
from typing import Any

from ..io.text.values import KeyPath, Scope, ValueType, as_number

# All public power grids use one of these.
FREQUENCIES_HZ = (50.0, 60.0)
Mains = str | float | None


@dataclass(frozen=True, kw_only=True)
class MainsFrequency(ValueType):
    """``auto``, 50 or 60 Hz.

    Parameters
    ----------
    optional : bool
        Whether null, a room without lamps, is allowed.
    """

    @property
    def allowed(self) -> str:
        return "'auto' or 50 or 60 Hz"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> Mains:
        if isinstance(value, str) and value == "auto":
            return "auto"
        number = as_number(value)
        if number not in FREQUENCIES_HZ:
            raise where.error(self.rule, value)
        return number

    def _json_schema(self) -> dict[str, Any]:
        # Numbers may be typed as text, as everywhere in these files.
        return {"enum": ["auto", *FREQUENCIES_HZ, *(f"{hz:g}" for hz in FREQUENCIES_HZ)]}
