# SPDX-License-Identifier: GPL-3.0-or-later
"""The reflection of the tag's open switches, as a type of value in scene files."""

from dataclasses import dataclass
from typing import Any

from ..io.text.values import KeyPath, Number, Scope, ValueType, as_number


@dataclass(frozen=True, kw_only=True)
class OffReflection(ValueType):
    """G_off / rho, complex: one pair [re, im] for both switches, or a pair for each.

    Read as a tuple of two complex numbers.

    Parameters
    ----------
    optional : bool
        Whether null is allowed.
    """

    @property
    def allowed(self) -> str:
        return "a pair [re, im] of magnitude below 1, or a list of two such pairs"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> tuple[complex, complex]:
        pairs = value if _is_pair(value) and _is_pair(value[0]) else [value, value]
        first, second = (_as_complex(pair) for pair in pairs)
        if first is None or second is None or max(abs(first), abs(second)) >= 1:
            raise where.error(self.rule, value)
        return first, second

    def plain(self, value: tuple[complex, complex]) -> list[Any]:
        first, second = ([number.real, number.imag] for number in value)
        return first if first == second else [first, second]

    def _json_schema(self) -> dict[str, Any]:
        part = Number(low=-1, above=True, high=1).json_schema() | {"exclusiveMaximum": 1}
        sizes = {"type": "array", "minItems": 2, "maxItems": 2}
        pair = sizes | {"items": part}
        return {"anyOf": [pair, sizes | {"items": pair}]}


def _is_pair(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2


def _as_complex(value: Any) -> complex | None:
    real, imaginary = map(as_number, value) if _is_pair(value) else (None, None)
    return None if real is None or imaginary is None else complex(real, imaginary)
