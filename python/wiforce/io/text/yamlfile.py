# SPDX-License-Identifier: GPL-3.0-or-later
"""YAML files: safe reading (limits on size and depth, no aliases, no repeated keys), writing."""

from pathlib import Path
from typing import Any

import yaml

from ...errors import InputError, unwritable
from .textfile import read_bytes, write_whole

MAX_BYTES = 2_000_000
MAX_DEPTH = 16


# libyaml's parser is ten times as fast as Python's.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SafeLoader):
    """Safe loader that rejects repeated keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
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


def _check_structure(data: bytes) -> None:
    """Reject aliases and deep nesting, both of which a loader would follow by recursion."""
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


def read_yaml(path: str | Path) -> dict[Any, Any]:
    """Read the mapping at the top of a YAML file.

    Raises
    ------
    InputError
        When the file cannot be read, is larger than 2 MB, is nested deeper than 16 levels, is not
        YAML, contains aliases or repeated keys, or has no mapping at the top. The message is one
        line with the file and, where known, line and column.
    """
    data = read_bytes(path, MAX_BYTES)
    try:
        _check_structure(data)
        content = yaml.load(data, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = _line(error.problem)
        if mark and "cannot start any token" in problem and b"\t" in data.splitlines()[mark.line]:
            problem = "a tab, but YAML is indented with spaces only"
        raise InputError(path, f"is not valid YAML{place}: {problem}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(path, f"is not valid YAML: {_line(error)}") from error
    if not isinstance(content, dict):
        kind = {type(None): "empty", list: "a list"}.get(type(content), "text")
        raise InputError(path, f"must hold a mapping of keys to values, is {kind}")
    return content


def write_yaml(path: str | Path, content: dict[str, Any], heading: str = "") -> None:
    """Write a YAML file, whole or not at all; keys stay in their order.

    Parameters
    ----------
    content : dict
        Plain values.
    heading : str
        Text before them, such as a comment.

    Raises
    ------
    InputError
        When the file cannot be written.
    OutputError
        When the disk is full.
    """
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    try:
        write_whole(path, heading + text)
    except OSError as error:
        raise unwritable(path, error) from error


def _line(text: object) -> str:
    return " ".join(str(text).split())[:200]
