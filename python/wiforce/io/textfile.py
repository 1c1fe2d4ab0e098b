# SPDX-License-Identifier: GPL-3.0-or-later
"""Text files: read up to a limit, for they come from outside; written whole or not at all, and
not before all is known to be well."""

import csv
import io
import os
from pathlib import Path

from ..errors import InputError

MAX_CSV_BYTES = 32_000_000


def read_bytes(path, limit):
    """A file's content.

    Parameters
    ----------
    path : str or Path
    limit : int
        Bytes that it may have.

    Raises
    ------
    InputError
        When it cannot be read or is larger.
    """
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


def read_csv(path):
    """A CSV file in UTF-8.

    Returns
    -------
    header : tuple of str
    rows : list of (int, dict)
        Line number and cells by column, None where a row is short; empty rows are left out.

    Raises
    ------
    InputError
        When it cannot be read, is larger than 32 MB, is no CSV or holds no row.
    """
    data = read_bytes(path, MAX_CSV_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""))
        header = tuple(reader.fieldnames or ())
        rows = [(reader.line_num, row) for row in reader if any(row.values())]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is not a CSV file ({error})") from error
    if not rows:
        raise InputError(path, "has no rows")
    return header, rows


def check_output(path):
    """Refuses a path that nothing can be written to, before any work is done for it.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        For a folder that is not there or a file that cannot be written.
    """
    path = Path(path)
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise InputError(path, "cannot be written (folder does not exist)")
        writable = os.access(path if path.exists() else folder, os.W_OK) and not path.is_dir()
    except OSError as error:  # a name that is too long
        raise InputError(path, f"cannot be written ({error.strerror})") from error
    if not writable:
        raise InputError(path, "cannot be written")


def write_whole(path, text):
    """Writes a file in UTF-8, or replaces it; what was there stays when that fails.

    Raises
    ------
    OSError
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
