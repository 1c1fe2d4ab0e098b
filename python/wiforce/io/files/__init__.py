# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings: CSV, JSON lines, Parquet and MCAP, known by the suffix of a name."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple


class Format(NamedTuple):
    """A format of files of readings, named by the ``option`` of commands that write it.

    Rows of a ``text`` are lines, whole at once; other formats hold scene and sensors, and need an
    end.
    """

    suffix: str
    text: bool
    option: str = "-o"


FORMATS = (
    Format(".csv", text=True),
    Format(".jsonl", text=True),
    Format(".parquet", text=False),
    Format(".mcap", text=False, option="--mcap"),
)
OUTPUTS = tuple(each for each in FORMATS if each.option == "-o")
# Of the option -o of all commands.
OUTPUTS_HELP = "OUT.csv, OUT.jsonl or OUT.parquet"


def format_of(path: str | Path | None) -> Format | None:
    """The format that a name stands for; None where it stands for none."""
    name = str(path).lower()
    return next((each for each in FORMATS if name.endswith(each.suffix)), None)


def suffixes(formats: Iterable[Format]) -> str:
    """Suffixes as a message lists them."""
    *others, last = [each.suffix for each in formats]
    return f"{', '.join(others)} or {last}"
