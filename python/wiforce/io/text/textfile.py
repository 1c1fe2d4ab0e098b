# SPDX-License-Identifier: GPL-3.0-or-later
"""Text, CSV and YAML files: reading, cells, and writing in one step."""

import csv
import io
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from ...errors import InputError, unwritable

MAX_CSV_BYTES = 32_000_000


def read_bytes(path: str | Path, limit: int) -> bytes:
    """Read a file, or refuse one that is larger than a limit."""
    try:
        with open(path, "rb") as stream:
            data = stream.read(limit + 1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except ValueError as error:  # a NUL in the name
        raise InputError(repr(str(path)), f"cannot be read ({error})") from error
    if len(data) > limit:
        raise InputError(path, f"must not be larger than {limit // 1_000_000} MB")
    return data


def read_csv(path: str | Path) -> tuple[tuple[str, ...], list[tuple[int, dict[str, str]]]]:
    """Columns of a CSV file of at most 32 MB, and its rows, by column, with line numbers.

    Refuses a file without rows, columns of one name, and rows that are too long. The columns that a
    short row lacks are None.
    """
    data = read_bytes(path, MAX_CSV_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""))
        header = tuple(reader.fieldnames or ())
        if len(header) == 1 and (other := next((c for c in ";\t" if c in header[0]), None)):
            raise InputError(path, "columns must be separated by commas", other)
        repeated = [name for name, count in Counter(header).items() if name and count > 1]
        if repeated:
            raise InputError(path, "columns must have different names", repeated[0])
        rows = []
        for row in reader:
            if (surplus := row.pop(None, None)) is not None:
                rule = f"must have as many fields as there are columns, {len(header)}"
                raise InputError(f"{path}: row {reader.line_num}", rule, len(header) + len(surplus))
            if any(row.values()):
                rows.append((reader.line_num, row))
    except UnicodeDecodeError as error:
        raise InputError(path, "must be text in UTF-8; save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise InputError(path, f"is not a CSV file ({error})") from error
    if not rows:
        raise InputError(path, "has no rows")
    return header, rows


def check_output(path: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Refuse a path that cannot be written to, or is an input, before any work is done."""
    path = Path(path)
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise InputError(path, "cannot be written (folder does not exist)")
        if path.is_dir():
            raise InputError(path, "cannot be written (is a folder)")
        writable = os.access(path if path.exists() else folder, os.W_OK)
    except OSError as error:  # a name that is too long
        raise InputError(path, f"cannot be written ({error.strerror})") from error
    if not writable:
        raise InputError(path, "cannot be written (permission denied)")
    for source in inputs:
        if path.exists() and os.path.exists(source) and os.path.samefile(path, source):
            named = "an input" if Path(source) == path else f"the same file as the input {source}"
            raise InputError(path, f"cannot be written (is {named})")


def write_whole(path: str | Path, text: str) -> None:
    """Write a file in UTF-8, or replace it; OSError when that fails keeps the previous content."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def write_text(path: str | Path, text: str) -> None:
    """As :func:`write_whole`; an InputError or OutputError names the file and the reason."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise unwritable(path, error) from error


def write_csv(path: str | Path, frame: Any) -> None:
    """Write a pandas frame with four decimals, whole or not at all."""
    write_text(path, frame.to_csv(index=False, float_format="%.4f"))


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give the path of a file beside another, which it replaces if the block succeeds.

    The target of a link is replaced; a device or a pipe is given itself.
    """
    suffix = Path(path).suffix  # by which the format of what is written is known
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        yield path
        return
    # Named after the process: no other file, least of all an input, has this name.
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{suffix}")
    try:
        yield part
        if part.exists():
            # A machine that fails would leave an empty file in place of the former one.
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(path)
    except InputError as error:
        raise error.renamed({str(part): str(path)}) from None
    finally:
        part.unlink(missing_ok=True)


_LARGEST = 1e6  # of any number in a table: MHz, mm, N, degrees, s


def require_columns(
    path: str | Path, header: Sequence[str], needed: Sequence[str], hint: str = ""
) -> None:
    """Refuse a table that lacks columns; ``hint`` says what to do, or else they are listed."""
    missing = [name for name in needed if name not in header]
    if missing:
        reason = hint or f"missing: {', '.join(missing)}"
        rule = f"must have the columns {', '.join(needed)} ({reason})"
        raise InputError(path, rule, ",".join(header))


def cell_number(
    row: Mapping[str, Any],
    column: str,
    where: str,
    empty: float | None = None,
    largest: float = _LARGEST,
) -> float:
    """The number in a cell, at most ``largest``; ``empty`` where it is, or refused."""
    text = (row.get(column) or "").strip()
    if not text and empty is not None:
        return empty
    try:
        # Python reads 1_0 and digits of other scripts as well, which nobody means.
        value = float(text if text.isascii() and "_" not in text else "")
    except ValueError:
        rule = "must be a number" + (" with a decimal point" if "," in text else "")
        raise InputError(f"{where}: {column}", rule, text) from None
    if not abs(value) <= largest:
        raise InputError(f"{where}: {column}", f"must be finite and at most {largest:g}", text)
    return value


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
    """Read the mapping of a YAML file (:func:`parse_yaml`)."""
    return parse_yaml(path, yaml_bytes(path))


def yaml_bytes(path: str | Path) -> bytes:
    """Read a YAML file of at most 2 MB; refuses a pipe, whose writer may never come."""
    refuse_pipe(path)
    return read_bytes(path, MAX_BYTES)


def refuse_pipe(path: str | Path) -> None:
    """Refuse what exists but is neither a file nor a folder."""
    # Unlike a Path's, this answers for names that no file can have.
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise InputError(path, "must be a file, not a pipe or a device")


def parse_yaml(path: str | Path, data: bytes) -> dict[Any, Any]:
    """The mapping in the bytes of a YAML file; refuses other content.

    Refused are nesting deeper than 16 levels, aliases and repeated keys.
    """
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
    """Write plain values in their order to a YAML file below a heading, whole or not at all."""
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    write_text(path, heading + text)


def _line(text: object) -> str:
    return " ".join(str(text).split())[:200]
