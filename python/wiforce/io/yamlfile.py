# SPDX-License-Identifier: GPL-3.0-or-later
"""Checked reading of YAML: safe loader, limits on size and depth, typed access by dotted key."""

import math
import re

import yaml

from ..errors import InputError
from .textfile import read_bytes

MAX_BYTES = 2_000_000
MAX_DEPTH = 16
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


# libyaml's parser is ten times as fast as Python's.
class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """Safe loader that refuses repeated keys."""

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                continue
            if key_node.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key_node.value[:60]!r} is given twice",
                    problem_mark=key_node.start_mark,
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


def _check_structure(data):
    """Refuses aliases and depth, which a loader would follow by recursion."""
    depth = 0
    for event in yaml.parse(data, _Loader):
        if isinstance(event, yaml.AliasEvent):
            problem = "aliases are not allowed"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        if isinstance(event, yaml.NodeEvent) and depth == MAX_DEPTH:
            problem = f"must not be nested deeper than {MAX_DEPTH} levels"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)


def read_yaml(path):
    """The mapping at the top of a YAML file, as a dict.

    Raises
    ------
    InputError
        When the file cannot be read, is larger than 2 MB, nested deeper than 16 levels, is not
        YAML, holds aliases or repeated keys, or has no mapping at the top. One line, with the
        file and, where known, line and column.
    """
    data = read_bytes(path, MAX_BYTES)
    try:
        _check_structure(data)
        content = yaml.load(data, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise InputError(path, f"is not valid YAML{place}: {_line(error.problem)}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(path, f"is not valid YAML: {_line(error)}") from error
    if not isinstance(content, dict):
        kind = "empty" if content is None else f"a {type(content).__name__}"
        raise InputError(path, f"must hold a mapping of keys to values, is {kind}")
    return content


def _line(text):
    return " ".join(str(text).split())[:200]


def as_number(value):
    """``value`` as a finite float, or None when it is no such number.

    Text such as ``900e6`` counts as a number: PyYAML reads it as a string.
    """
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        value = float(value)
    except OverflowError:
        return None
    return value if math.isfinite(value) else None


class Section:
    """A mapping of a description, read key by key; what was never asked for is refused.

    Parameters
    ----------
    values : dict
    source : str
        Name of the file (or of whatever gave the mapping), for messages.
    prefix : str
        Dotted key of this mapping within its source.
    """

    def __init__(self, values, source, prefix=""):
        self.source, self._prefix = source, prefix
        if not isinstance(values, dict):
            raise InputError(self.where(), "must be a mapping of keys to values", values)
        self._values = values
        self._asked = {}

    def where(self, key=None):
        """``file: dotted.key``, the place that a message names."""
        dotted = ".".join(str(part) for part in (self._prefix, key) if part not in ("", None))
        return f"{self.source}: {dotted}" if dotted else self.source

    def error(self, key, rule, *value):
        return InputError(self.where(key), rule, *value)

    def raw(self, key, default=None):
        """The value as it stands in the file, unchecked; ``default`` where there is none."""
        self._asked[key] = True
        return self._values.get(key, default)

    def number(self, key, default=None, low=None, high=None, above=None, optional=False):
        """A float with ``low <= x <= high`` and ``x > above``; None where ``optional``."""
        value = self.raw(key, default)
        if value is None and optional:
            return None
        rule = "must be a number" + _range(low, high, above) + (" or null" if optional else "")
        if value is None:
            raise self.error(key, f"is missing, {rule}")
        number = as_number(value)
        if (
            number is None
            or (low is not None and number < low)
            or (high is not None and number > high)
            or (above is not None and number <= above)
        ):
            raise self.error(key, rule, value)
        return number

    def integer(self, key, default=None, low=None, high=None, optional=False):
        """An int with ``low <= n <= high``; None where ``optional``."""
        value = self.raw(key, default)
        if value is None and optional:
            return None
        rule = "must be an integer" + _range(low, high) + (" or null" if optional else "")
        if value is None:
            raise self.error(key, f"is missing, {rule}")
        number = as_number(value)
        if number is None or number != int(number):
            raise self.error(key, rule, value)
        number = value if isinstance(value, int) else int(number)
        if (low is not None and number < low) or (high is not None and number > high):
            raise self.error(key, rule, value)
        return number

    def text(self, key, default=None, limit=255, optional=False):
        """A printable, non-empty string of at most ``limit`` characters."""
        value = self.raw(key, default)
        if value is None and optional:
            return None
        rule = f"must be printable text of 1 to {limit} characters"
        if value is None:
            raise self.error(key, f"is missing, {rule}")
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise self.error(key, rule, value)
        if len(value) > limit:
            raise self.error(key, rule, value)
        return value

    def choice(self, key, choices, default=None):
        """One of some strings."""
        value = self.raw(key, default)
        if not isinstance(value, str) or value not in choices:
            rule = "must be " + " or ".join(f"'{c}'" for c in choices)
            raise self.error(key, rule, value)
        return value

    def section(self, key):
        """The mapping under ``key``; empty when absent."""
        value = self.raw(key)
        return Section({} if value is None else value, self.source, self._dotted(key))

    def sections(self, key, limit, required=False):
        """The mappings in the list under ``key``; empty when absent and not required."""
        value = self.raw(key)
        if value is None and not required:
            return []
        rule = f"must be a list of {1 if required else 0} to {limit} mappings"
        if value is None:
            raise self.error(key, f"is missing, {rule}")
        if not isinstance(value, list | tuple) or len(value) > limit or (required and not value):
            raise self.error(key, rule, value)
        prefix = self._dotted(key)
        return [Section(v, self.source, f"{prefix}[{i}]") for i, v in enumerate(value)]

    def finish(self):
        """Refuse every key that was never asked for."""
        for key in self._values:
            if key not in self._asked:
                known = ", ".join(self._asked)
                raise self.error(str(key)[:60], f"is not a known key (known: {known})")

    def _dotted(self, key):
        return f"{self._prefix}.{key}" if self._prefix else key


def _range(low=None, high=None, above=None):
    if low is not None and high is not None:
        return f" from {low:g} to {high:g}"
    if above is not None and high is not None:
        return f" above {above:g} and at most {high:g}"
    if above is not None:
        return f" above {above:g}"
    if low is not None:
        return f" of at least {low:g}"
    return f" of at most {high:g}" if high is not None else ""
