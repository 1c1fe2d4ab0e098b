# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of a file of readings to which a further run is appended."""

import os
from pathlib import Path

from ..errors import InputError

# The longest row that a run may have left incomplete when its machine failed.
_LONGEST_ROW = 65_536


def prepare_append(path: str | Path, header: str) -> int:
    """Check that a file can be appended to, and cut off a last row that is incomplete.

    Returns int: size of the file in bytes, 0 when it does not exist or is empty.

    Parameters
    ----------
    path : str or Path
        A regular file.
    header : str
        First line that the file must have, with its newline; empty when there is none.

    Raises
    ------
    InputError
        When the file begins with another line.
    """
    if not Path(path).exists():
        return 0
    with open(path, "r+b") as file:
        first = file.readline(_LONGEST_ROW)
        if first and not _may_begin(first, header.encode()):
            rule = "must begin with the columns of these readings, or nothing can be appended"
            raise InputError(path, rule, first.decode("utf-8", "replace").strip())
        size = file.seek(0, os.SEEK_END)
        start = max(size - _LONGEST_ROW, 0)
        file.seek(start)
        end = file.read().rfind(b"\n") + 1
        whole = start + end if end else 0
        file.truncate(whole)
    return whole


def _may_begin(line: bytes, header: bytes) -> bool:
    """Whether a file of readings may begin with a line, which may be incomplete."""
    if not header:
        return line.startswith(b"{")
    return line == header if line.endswith(b"\n") else header.startswith(line)
