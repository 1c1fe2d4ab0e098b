# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages in Markdown: tables, and templates whose text stands in a file beside their module."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table as lines of Markdown.

    Parameters
    ----------
    head : sequence of str
        Titles of the columns.
    rows : iterable of sequence of str
        Cells of each row, as many as titles.
    """
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def filled_page(template: Path, **values: str) -> str:
    """The text of a template with its ``$names`` replaced by values.

    Parameters
    ----------
    template : Path
        Markdown with names as in `string.Template`; ``$$`` stands for a dollar.
    **values : str
        One per name of the template.

    Raises
    ------
    KeyError
        When the template holds a name without a value.
    """
    return Template(template.read_text(encoding="utf-8")).substitute(values)
