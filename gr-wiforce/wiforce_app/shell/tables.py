# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of results as aligned tables in Markdown, which a terminal shows as well, or as JSON."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click


@dataclass(frozen=True)
class Column:
    """A column of a table: title, key of its value in a row, and its format or a function.

    Lists, of both ends, are separated by slashes; None or nothing is left empty, text stays.
    """

    title: str
    key: str
    form: str | Callable[[Any], str] = ""

    def text(self, row: Mapping[str, Any]) -> str:
        value = row.get(self.key)
        values = value if isinstance(value, list | tuple) else [value]
        return "/".join("" if v is None else self._written(v) for v in values)

    def _written(self, value: Any) -> str:
        if isinstance(value, str):
            return value
        return format(value, self.form) if isinstance(self.form, str) else self.form(value)


def table(rows: Iterable[Mapping[str, Any]], columns: Sequence[Column]) -> str:
    head = [column.title for column in columns]
    cells = [[column.text(row) for column in columns] for row in rows]
    widths = [max(3, *map(len, column)) for column in zip(head, *cells, strict=True)]
    lines = [head, ["-" * width for width in widths], *cells]
    return "\n".join(f"| {' | '.join(map(str.ljust, line, widths))} |" for line in lines)


def echo(result: Any, as_json: bool, *tables: Callable[[Any], str]) -> None:
    """Print a result as JSON, or as the tables that functions make of it."""
    click.echo(json.dumps(result, indent=1) if as_json else "\n\n".join(t(result) for t in tables))
