# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of values in YAML files: each checks, documents and writes a value of its type.

A type states its rule once. The parser (:meth:`ValueType.read`), the error message, the tables in
docs/ (:attr:`ValueType.allowed`) and the JSON Schema (:meth:`ValueType.json_schema`) follow.
"""

import datetime
import math
import re
from abc import ABC, abstractmethod
from collections import ChainMap
from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ...errors import InputError

# Values read so far, innermost mapping first: what a default, a size or a check may depend on.
Scope = ChainMap[str, Any]

_NUMBER_AS_TEXT = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*$"


def as_number(value: Any) -> float | None:
    """A value of a YAML file as a finite float, also text such as ``900e6``; None otherwise."""
    if isinstance(value, str) and re.match(_NUMBER_AS_TEXT, value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, Real):  # also one of NumPy
        return None
    try:
        value = float(value)
    except OverflowError:
        return None
    return value if math.isfinite(value) else None


class KeyPath(NamedTuple):
    """Where a value is, as messages name it: file and dotted key, empty for its top."""

    source: str
    dotted: str = ""

    def key(self, name: str) -> "KeyPath":
        """The path of a key of the mapping at this path."""
        return KeyPath(self.source, f"{self.dotted}.{name}" if self.dotted else name)

    def item(self, index: int) -> "KeyPath":
        """The path of an item of the list at this path."""
        return KeyPath(self.source, f"{self.dotted}[{index}]")

    def error(self, rule: str, *value: Any) -> InputError:
        """The error to raise for a value at this path that breaks a rule."""
        return InputError(str(self), rule, *value)

    def __str__(self) -> str:
        return f"{self.source}: {self.dotted}" if self.dotted else self.source


@dataclass(kw_only=True, eq=False, repr=False)
class ValueType(ABC):
    """A type of value and its rule; ``optional`` allows ``null``."""

    optional: bool = False

    @property
    @abstractmethod
    def allowed(self) -> str:
        """What is allowed, as it follows "must be" in a message; without ``null``."""

    @property
    def rule(self) -> str:
        """The rule, as messages state it."""
        return f"must be {self.allowed}" + (" or null" if self.optional else "")

    @property
    def empty(self) -> Any:
        """What is read in place of an absent value, if anything."""
        return None

    @property
    def may_be_absent(self) -> bool:
        """Whether a key of this type may be left out even where no default is declared."""
        return self.optional or self.empty is not None

    def read(self, value: Any, where: KeyPath, scope: Scope) -> Any:
        """Check and convert a value of the YAML loader; ``scope`` are values read before."""
        if value is None and self.optional:
            return None
        if value is None and self.empty is None:
            raise where.error(f"is missing, {self.rule}")
        return self._read(self.empty if value is None else value, where, scope)

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> Any:
        """As :meth:`read`, for a value that is not None."""
        found = self._converted(value)
        if found is None:
            raise where.error(self.rule, value)
        return found

    def _converted(self, value: Any) -> Any:
        """A value that is not None as it is used; None for one that breaks the rule."""
        raise NotImplementedError

    def plain(self, value: Any) -> Any:
        """The value as YAML and JSON can hold it."""
        return value

    def json_schema(self) -> dict[str, Any]:
        """The rule as JSON Schema, draft 7, but for numbers as text and checks of other values."""
        schema = self._json_schema()
        if self.optional and "type" in schema:
            types = schema["type"]
            schema["type"] = [*([types] if isinstance(types, str) else types), "null"]
        elif self.optional and "enum" in schema:
            schema["enum"] = [*schema["enum"], None]
        return schema

    @abstractmethod
    def _json_schema(self) -> dict[str, Any]:
        """As :meth:`json_schema`, without null."""


@dataclass(kw_only=True, eq=False, repr=False)
class Number(ValueType):
    """A finite number between two limits in a unit; ``above`` excludes ``low`` itself."""

    unit: str = ""
    low: float
    high: float
    above: bool = False
    _noun: ClassVar[str] = "a number"
    _json_type: ClassVar[str] = "number"

    @property
    def allowed(self) -> str:
        limits = ("above {:g} and at most {:g}" if self.above else "from {:g} to {:g}").format(
            self.low, self.high
        )
        return f"{self._noun} {limits} {self.unit}".rstrip()

    def _converted(self, value: Any) -> float | None:
        number = self._number(value)
        if number is None or not self.low <= number <= self.high:
            return None
        return None if self.above and number == self.low else number

    def _number(self, value: Any) -> float | None:
        return as_number(value)

    def _json_schema(self) -> dict[str, Any]:
        return {
            "type": [self._json_type, "string"],
            "exclusiveMinimum" if self.above else "minimum": self.low,
            "maximum": self.high,
            "pattern": _NUMBER_AS_TEXT,
        }


class Integer(Number):
    """An integer between two limits; ``720.0`` counts as one."""

    _noun: ClassVar[str] = "an integer"
    _json_type: ClassVar[str] = "integer"

    def _number(self, value: Any) -> int | None:
        number = as_number(value)
        if number is None or number != int(number):
            return None
        # A float does not hold every large integer, for example of a seed.
        return value if isinstance(value, int) else int(number)


class AutomaticNumber(Number):
    """A number, or the word ``auto``, which is read as None: the program finds it itself."""

    @property
    def allowed(self) -> str:
        return f"'auto' or {super().allowed}"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> float | None:
        return None if value == "auto" else super()._read(value, where, scope)

    def plain(self, value: Any) -> Any:
        return "auto" if value is None else value

    def _json_schema(self) -> dict[str, Any]:
        return {"anyOf": [{"enum": ["auto"]}, super()._json_schema()]}


@dataclass(kw_only=True, eq=False, repr=False)
class Text(ValueType):
    """Printable text with at most ``limit`` characters that is not blank."""

    limit: int = 255

    @property
    def allowed(self) -> str:
        return f"printable text of 1 to {self.limit} characters"

    def _converted(self, value: Any) -> str | None:
        printable = isinstance(value, str) and value.strip() and value.isprintable()
        return value if printable and len(value) <= self.limit else None

    def _json_schema(self) -> dict[str, Any]:
        return {
            "type": "string",
            "pattern": r"\S",
            "not": {"type": "string", "pattern": r"[\x00-\x1f\x7f]"},
            "maxLength": self.limit,
        }


class Texts(ValueType):
    """A list of texts of any length."""

    allowed = "a list of texts"

    def _converted(self, value: Any) -> list[str] | None:
        texts = isinstance(value, list) and all(isinstance(text, str) for text in value)
        return value if texts else None

    def _json_schema(self) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "string"}}


@dataclass(kw_only=True, eq=False, repr=False)
class Choice(ValueType):
    """One of some words."""

    words: tuple[str, ...]

    @property
    def allowed(self) -> str:
        return " or ".join(f"'{word}'" for word in self.words)

    def _converted(self, value: Any) -> str | None:
        return value if isinstance(value, str) and value in self.words else None

    def _json_schema(self) -> dict[str, Any]:
        return {"enum": list(self.words)}


class Date(ValueType):
    """A date as text; YAML's own dates are converted to ISO 8601."""

    allowed = "a date such as 2026-01-31"

    def _converted(self, value: Any) -> str | None:
        if isinstance(value, datetime.date):
            return value.isoformat()
        return value if isinstance(value, str) else None

    def _json_schema(self) -> dict[str, Any]:
        return {"type": "string"}


@dataclass(kw_only=True, eq=False, repr=False)
class AnyMapping(ValueType):
    """A mapping of which only the keys ``known`` are checked, where it has them."""

    known: dict[str, ValueType] = field(default_factory=dict)

    allowed = "a mapping of keys to values"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> dict[Any, Any]:
        if not isinstance(value, dict):
            raise where.error(self.rule, value)
        found = {
            name: known.plain(known.read(value[name], where.key(name), scope))
            for name, known in self.known.items()
            if name in value
        }
        return value | found

    def _json_schema(self) -> dict[str, Any]:
        properties = {name: known.json_schema() for name, known in self.known.items()}
        return {"type": "object", "properties": properties}


LARGEST = 1e12  # of any number: squares and ratios of such numbers are still finite


class Size(NamedTuple):
    """A length that follows from other values: its symbol, and a function of the scope."""

    symbol: str
    of: Callable[[Scope], int]


@dataclass(kw_only=True, eq=False, repr=False)
class Array(ValueType):
    """Nested lists of numbers of a shape: ints, :class:`Size` or None; one axis maybe a tuple."""

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
