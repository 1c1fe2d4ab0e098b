# SPDX-License-Identifier: GPL-3.0-or-later
"""names.h and names.py say the same: blocks of both languages find each other's tags."""

import re
from pathlib import Path

from gnuradio.wiforce import names

HEADER = Path(__file__).resolve().parent.parent / "include/gnuradio/wiforce/names.h"


def test_both_languages_use_the_same_names():
    in_cpp = dict(re.findall(r'constexpr char (\w+)\[\] = "([^"]*)";', HEADER.read_text()))
    in_python = {k: v for k, v in vars(names).items() if k.isupper()}
    assert in_cpp == in_python
    assert len(in_cpp) >= 9
