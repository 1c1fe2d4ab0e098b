# SPDX-License-Identifier: GPL-3.0-or-later
"""names.h and blocks/names.py say the same: blocks of both languages find each other's tags."""

import re
from pathlib import Path

from gnuradio.wiforce.blocks import names

ROOT = Path(__file__).resolve().parents[2]
HEADER = ROOT / "include/gnuradio/wiforce/names.h"


def test_both_languages_use_the_same_names():
    in_cpp = dict(re.findall(r'constexpr char (\w+)\[\] = "([^"]*)";', HEADER.read_text()))
    in_python = {k: v for k, v in vars(names).items() if k.isupper()}
    assert in_cpp == in_python
    assert len(in_cpp) >= 9


def test_every_tag_and_port_has_a_row_in_the_table():
    table = (ROOT / "docs/architecture.md").read_text().split("### Tags, ports and keys")[1]
    rows = [
        row.split("|")[1] for row in table.split("\n## ")[0].splitlines() if row.startswith("| `")
    ]
    found = {name for row in rows for name in re.findall("`(.*?)`", row)}
    # Keys of the messages on the ports `tare` and `warnings`.
    keys = {names.FORCE, names.TEXT}
    assert found == {v for k, v in vars(names).items() if k.isupper()} - keys
