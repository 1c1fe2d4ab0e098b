# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of numbers in YAML files, as a type of value (see :mod:`.values`)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .values import KeyPath, Number, Scope, ValueType, as_number

LARGEST = 1e12  # of any number: squares and ratios of such numbers are still finite


@dataclass(frozen=True)
class Size:
    """A length that follows from other values of the file.

    Parameters
    ----------
    symbol : str
        For the documentation.
    of : callable
        Scope to length.
    """

    symbol: str
    of: Callable[[Scope], int]


@dataclass(frozen=True, kw_only=True)
class Array(ValueType):
    """Nested lists of numbers of a given shape.

    Parameters
    ----------
    shape : tuple
        Per axis an int, a :class:`Size`, or None for any length above 0.
    low, high : float
        Least and largest number.
    as_tuple : bool
        Whether the value, which has one axis, is read as a tuple of floats instead of an array.
    """

    shape: tuple[int | Size | None, ...]
    unit: str = ""
    low: float = -LARGEST
    high: float = LARGEST
    as_tuple: bool = False

    @property
    def allowed(self) -> str:
        if (self.low, self.high) != (-LARGEST, LARGEST):
            limits = f" from {self.low:g} to {self.high:g} {self.unit}"
        else:
            limits = f" in {self.unit}" if self.unit else ""
        symbols = [size.symbol if isinstance(size, Size) else size for size in self.shape]
        return f"{_list_of(symbols)}{limits}"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> np.ndarray | tuple[float, ...]:
        shape = [size.of(scope) if isinstance(size, Size) else size for size in self.shape]
        try:
            numbers = np.array(_nested(value, shape), float)
        except ValueError:
            raise where.error(f"must be {_list_of(shape)}", value) from None
        outside = numbers[(numbers < self.low) | (numbers > self.high)]
        if outside.size:
            rule = f"must hold numbers from {self.low:g} to {self.high:g}"
            raise where.error(rule, float(outside[0]))
        return tuple(numbers.tolist()) if self.as_tuple else numbers

    def plain(self, value: Any) -> Any:
        return None if value is None else np.asarray(value).tolist()

    def _json_schema(self) -> dict[str, Any]:
        schema = Number(low=self.low, high=self.high).json_schema()
        for size in reversed(self.shape):
            limits = {"minItems": size, "maxItems": size} if isinstance(size, int) else {}
            schema = {"type": "array", "items": schema, "minItems": 1, **limits}
        return schema


def _list_of(sizes: list[Any]) -> str:
    return f"a list of {' x '.join('n' if size is None else str(size) for size in sizes)} numbers"


def _nested(value: Any, shape: list[int | None]) -> Any:
    """Nested lists of floats; ValueError when the shape differs or an item is not a number."""
    if not shape:
        number = as_number(value)
        if number is None:
            raise ValueError
        return number
    if not isinstance(value, list) or len(value) != (shape[0] or max(len(value), 1)):
        raise ValueError
    return [_nested(item, shape[1:]) for item in value]
