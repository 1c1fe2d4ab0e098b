# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of tags are the same in both languages, and no constant of a file is given twice."""

import ast
import re
from collections import Counter
from pathlib import Path

from gnuradio.wiforce.blocks import names

ROOT = Path(__file__).resolve().parents[2]
HEADER = ROOT / "include/gnuradio/wiforce/names.h"


def test_both_languages_use_the_same_names():
    in_cpp = dict(re.findall(r'constexpr char (\w+)\[\] = "([^"]*)";', HEADER.read_text()))
    in_python = {k: v for k, v in vars(names).items() if k.isupper()}
    assert in_cpp == in_python
    assert len(in_cpp) >= 9


def test_no_constant_is_given_twice_in_a_file():
    """The second one would replace the first, of which a reader of the file sees nothing."""
    twice = []
    for path in (*ROOT.glob("python/**/*.py"), *ROOT.glob("gr-wiforce/**/*.py")):
        targets = []
        for statement in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(statement, ast.Assign):
                targets += statement.targets
            elif isinstance(statement, ast.AnnAssign):
                targets.append(statement.target)
        named = Counter(
            node.id
            for target in targets
            for node in ast.walk(target)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        )
        twice += [f"{path}: {name}" for name, count in named.items() if count > 1]
    assert not twice


def test_every_tag_and_port_has_a_row_in_the_table():
    table = (ROOT / "docs/architecture.md").read_text().split("### Tags, ports and keys")[1]
    rows = [
        row.split("|")[1] for row in table.split("\n## ")[0].splitlines() if row.startswith("| `")
    ]
    found = {name for row in rows for name in re.findall("`(.*?)`", row)}
    # Keys of the messages on the ports `tare` and `warnings`.
    keys = {names.FORCE, names.TEXT}
    assert found == {v for k, v in vars(names).items() if k.isupper()} - keys
