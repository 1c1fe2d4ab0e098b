# SPDX-License-Identifier: GPL-3.0-or-later
"""Mappings in YAML files, declared once as dataclasses.

A class decorated with :func:`declared` describes a mapping. Each of its fields is a :func:`key`
with the type of its value, its default and its documentation. :func:`read` parses a mapping,
:func:`plain` writes it, :func:`json_schema` describes it to editors, and the tables in docs/ list
its :func:`keys`.
"""

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

from .values import KeyPath, Scope, ValueType

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:
    # In the standard library since Python 3.11. Only type checkers make use of it.
    def dataclass_transform(**_):
        return lambda decorator: decorator


# YAML language servers take this draft; of later ones they support parts.
DRAFT_7 = "http://json-schema.org/draft-07/schema#"

T = TypeVar("T")


class Derived(NamedTuple):
    """A default that follows from other values; its function gives None where none does."""

    text: str
    of: Callable[[Scope], Any]


class Key(NamedTuple):
    """A key of a mapping, as :func:`key` declares it."""

    type: ValueType
    doc: str
    default: Any
    derived: Derived | None
    check: Callable[[Any, Scope], str | None] | None

    @property
    def required(self) -> bool:
        """Whether the key has no default of any kind."""
        no_default = self.default is dataclasses.MISSING and self.derived is None
        return no_default and not self.type.may_be_absent

    def read(self, values: dict[Any, Any], name: str, where: KeyPath, scope: Scope) -> Any:
        """The checked value of this key in a mapping, or its default."""
        if name in values:
            value = self.type.read(values[name], where, scope)
        elif self.derived:
            value = self.type.read(self.derived.of(scope), where, scope)
        elif self.default is not dataclasses.MISSING:
            value = self.default
        else:
            value = self.type.read(None, where, scope)
        rule = self.check(value, scope) if self.check else None
        if rule:
            raise where.error(rule, self.type.plain(value))
        return value


def key(
    type: ValueType,
    *,
    doc: str,
    default: Any = dataclasses.MISSING,
    derived: Derived | None = None,
    check: Callable[[Any, Scope], str | None] | None = None,
    compare: bool = True,
) -> Any:
    """Declare a key of a mapping, as a field of a class decorated with :func:`declared`.

    ``doc`` is a sentence. Without ``default`` (converted) and ``derived`` it is required, or None
    where allowed. ``check`` gives the text of a further rule that is broken. ``compare`` is whether
    two mappings that differ in it are unequal.
    """
    if type.optional and derived is None and default is dataclasses.MISSING:
        default = None
    metadata = {"key": Key(type, doc, default, derived, check)}
    return dataclasses.field(default=default, compare=compare, metadata=metadata)


class _Declared:
    """Methods of all classes that declare a mapping: those of a frozen dataclass."""

    def __init__(self, **values: Any) -> None:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        given = {each.name: each.default for each in fields} | values
        if len(given) > len(fields):
            raise TypeError(f"{type(self).__name__} has no {', '.join(list(given)[len(fields) :])}")
        if missing := [name for name, value in given.items() if value is dataclasses.MISSING]:
            raise TypeError(f"{type(self).__name__} needs {', '.join(missing)}")
        vars(self).update(given)

    def _compared(self) -> list[Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return [getattr(self, each.name) for each in fields if each.compare]

    def __repr__(self) -> str:
        names = [each.name for each in dataclasses.fields(self)]  # type: ignore[arg-type]
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
        return f"{type(self).__qualname__}({values})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return _Declared._compared(self) == _Declared._compared(other)

    def __hash__(self) -> int:
        return hash(tuple(_Declared._compared(self)))

    def __setattr__(self, name: str, value: Any) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(key,))
def declared(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass that declares, and documents, the keys of a mapping."""
    # Methods that dataclass compiles for each class would take most of the time to load a scene.
    cls = dataclass(init=False, repr=False, eq=False, kw_only=True)(cls)
    for name in "__init__ __repr__ __eq__ __hash__ __setattr__ __delattr__".split():
        setattr(cls, name, vars(_Declared)[name])
    attributes = [
        f"{name} : {each.type.allowed}\n    {each.doc}" for name, each in keys(cls).items()
    ]
    about = inspect.cleandoc(cls.__doc__ or "")
    cls.__doc__ = "\n".join([f"{about}\n", "Attributes", "----------", *attributes])
    return cls


def keys(cls: type) -> dict[str, Key]:
    """The keys that a declared class has, by name, in their order."""
    fields = dataclasses.fields(cls)
    return {field.name: field.metadata["key"] for field in fields if "key" in field.metadata}


def read(cls: type[T], values: Any, where: KeyPath, scope: Scope | None = None, **more: Any) -> T:
    """Read a mapping, as the YAML loader returns it, that a class declares.

    ``scope`` are values of enclosing mappings, ``more`` fields that are no keys. InputError for
    unknown keys and broken rules names file, key, rule and value.
    """
    if not isinstance(values, dict):
        raise where.error("must be a mapping of keys to values", values)
    _reject_unknown_keys(cls, values, where)
    found: dict[str, Any] = {}
    inner = (scope if scope is not None else Scope()).new_child(found)
    for name, each in keys(cls).items():
        found[name] = each.read(values, name, where.key(name), inner)
    return cls(**found, **more)


def _reject_unknown_keys(cls: type, values: dict[Any, Any], where: KeyPath) -> None:
    known = keys(cls)
    for name in values:
        if name not in known:
            import difflib  # only a file with an error pays for it

            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f", did you mean '{near[0]}'?" if near else ""
            if isinstance(name, int):  # of {force_n: 4,5}
                hint = "; between braces a comma separates keys, so write 4.5 and not 4,5"
            rule = f"is not a known key{hint} (known: {', '.join(known)})"
            raise where.key(str(name)[:60]).error(rule)


def plain(cls: type, source: Any) -> dict[str, Any]:
    """A declared mapping, or what has its attributes, as plain values for YAML and JSON."""
    return {name: each.type.plain(getattr(source, name)) for name, each in keys(cls).items()}


def json_schema(cls: type) -> dict[str, Any]:
    """Describe a declared mapping as JSON Schema, draft 7."""
    properties = {}
    for name, each in keys(cls).items():
        described = each.type.json_schema() | {"description": each.doc}
        if each.default is not dataclasses.MISSING:
            described["default"] = each.type.plain(each.default)
        properties[name] = described
    return {
        "type": "object",
        "properties": properties,
        "required": [name for name, each in keys(cls).items() if each.required],
        "additionalProperties": False,
    }


@dataclass(kw_only=True, eq=False, repr=False)
class Mapping(ValueType):
    """A mapping that a class declares; where absent all defaults, or None if ``optional``."""

    of: type

    allowed = "a mapping of keys to values"
    empty: ClassVar[Any] = {}

    @property
    def may_be_absent(self) -> bool:
        return self.optional or not any(each.required for each in keys(self.of).values())

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> Any:
        return read(self.of, value, where, scope)

    def plain(self, value: Any) -> dict[str, Any] | None:
        return None if value is None else plain(self.of, value)

    def _json_schema(self) -> dict[str, Any]:
        schema = json_schema(self.of)
        with_null = self.may_be_absent and not self.optional  # json_schema() adds the other null
        return schema | {"type": ["object", "null"]} if with_null else schema


def section(cls: type, *, absent: str | None = None) -> Any:
    """Declare a key that holds a mapping, which the first line of its class documents.

    ``absent`` is what null means, where it is allowed.
    """
    about = (cls.__doc__ or "").partition("\n")[0]
    if absent is None:
        return key(Mapping(of=cls), doc=about)
    return key(Mapping(of=cls, optional=True), doc=f"{about[:-1]}; null means {absent}.")


@dataclass(kw_only=True, eq=False, repr=False)
class ListOf(ValueType):
    """A list of ``least`` to ``most`` items, read as a tuple; absent where ``least`` is 0.

    Items are ``of`` a type of value, which ``items`` names, or mappings that a class declares.
    """

    of: type | ValueType
    least: int = 0
    most: int
    items: str = "mappings"

    def __post_init__(self) -> None:
        self.item = self.of if isinstance(self.of, ValueType) else Mapping(of=self.of)

    @property
    def allowed(self) -> str:
        return f"a list of {self.least} to {self.most} {self.items}"

    @property
    def empty(self) -> Any:
        return None if self.least else []

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not self.least <= len(value) <= self.most:
            raise where.error(self.rule, value)
        return tuple(self.item.read(item, where.item(i), scope) for i, item in enumerate(value))

    def plain(self, value: Any) -> list[Any] | None:
        return None if value is None else [self.item.plain(item) for item in value]

    def _json_schema(self) -> dict[str, Any]:
        return {
            "type": ["array", "null"] if self.least == 0 else "array",
            "items": self.item.json_schema(),
            "minItems": self.least,
            "maxItems": self.most,
        }
