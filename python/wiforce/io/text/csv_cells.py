# SPDX-License-Identifier: GPL-3.0-or-later
"""Columns and numbers of CSV tables that people fill in, with errors that say where."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...errors import InputError

_LARGEST = 1e6  # of any number in a table: MHz, mm, N, degrees, s


def require_columns(
    path: str | Path, header: Sequence[str], needed: Sequence[str], hint: str = ""
) -> None:
    """Refuse a table that lacks columns.

    Parameters
    ----------
    path : str or Path
        The table, for the message.
    header : sequence of str
        Names of its columns.
    hint : str
        What to do about it; the missing columns are listed where it is empty.

    Raises
    ------
    InputError
    """
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
    """The number in a cell.

    Parameters
    ----------
    row : mapping
        Cells by column (``textfile.read_csv``).
    where : str
        File and row, for the message.
    empty : float, optional
        Value of an empty cell, which is refused unless this is given.
    largest : float
        Largest magnitude; a million by default.

    Raises
    ------
    InputError
    """
    text = (row.get(column) or "").strip()
    if not text and empty is not None:
        return empty
    try:
        value = float(text)
    except ValueError:
        rule = "must be a number" + (" with a decimal point" if "," in text else "")
        raise InputError(f"{where}: {column}", rule, text) from None
    if not abs(value) <= largest:
        raise InputError(f"{where}: {column}", f"must be finite and at most {largest:g}", text)
    return value
