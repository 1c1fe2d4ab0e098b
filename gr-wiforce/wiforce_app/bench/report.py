# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of a benchmark as a table for people or as JSON for programs."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click


@dataclass(frozen=True)
class Column:
    """A column of a table: its title, the key of its value in a row, and how that is written.

    ``form`` is a format specification, or a function that makes text of a value. Values that are
    lists, one for each end, are separated by slashes; None is left empty.
    """

    title: str
    key: str
    form: str | Callable[[Any], str] = ""

    def text(self, row: Mapping[str, Any]) -> str:
        """The cell of a row."""
        value = row[self.key]
        values = value if isinstance(value, list | tuple) else [value]
        return "/".join("" if v is None else self._written(v) for v in values)

    def _written(self, value: Any) -> str:
        return format(value, self.form) if isinstance(self.form, str) else self.form(value)


def head_and_cells(
    rows: Iterable[Mapping[str, Any]], columns: Sequence[Column]
) -> tuple[list[str], list[list[str]]]:
    """Titles, and the cells of each row, as both kinds of tables take them."""
    titles = [column.title for column in columns]
    return titles, [[column.text(row) for column in columns] for row in rows]


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows as text, one line each, with aligned columns."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = ("  ".join(map(str.ljust, cells, widths)).rstrip() for cells in (head, *rows))
    return "\n".join(lines)


def echo(result: Any, as_json: bool, table: Callable[[], str]) -> None:
    """Print a result as JSON, or as the table that is made of it."""
    click.echo(json.dumps(result, indent=1) if as_json else table())
