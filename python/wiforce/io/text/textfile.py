# SPDX-License-Identifier: GPL-3.0-or-later
"""Text files: read up to a limit, as they come from outside, and written whole or not at all."""

import csv
import io
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import InputError

MAX_CSV_BYTES = 32_000_000


def read_bytes(path: str | Path, limit: int) -> bytes:
    """Read a file that must not be larger than a limit.

    Parameters
    ----------
    limit : int
        In bytes.

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


def read_csv(path: str | Path) -> tuple[tuple[str, ...], list[tuple[int, dict[str, str]]]]:
    """Read a CSV file in UTF-8.

    Returns
    -------
    header : tuple of str
        Names of the columns.
    rows : list of (int, dict)
        Line number and cells by column, None where a row is short; empty rows are left out.

    Raises
    ------
    InputError
        When it cannot be read, is larger than 32 MB, is not CSV or has no rows; when two columns
        have one name, or a row has more fields than there are columns.
    """
    data = read_bytes(path, MAX_CSV_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""))
        header = tuple(reader.fieldnames or ())
        if len(header) == 1 and (other := next((c for c in ";\t" if c in header[0]), None)):
            raise InputError(path, "columns must be separated by commas", other)
        repeated = [name for name, count in Counter(header).items() if name and count > 1]
        if repeated:
            raise InputError(path, "columns must have different names", repeated[0])
        rows = []
        for row in reader:
            if (surplus := row.pop(None, None)) is not None:
                rule = f"must have as many fields as there are columns, {len(header)}"
                raise InputError(f"{path}: row {reader.line_num}", rule, len(header) + len(surplus))
            if any(row.values()):
                rows.append((reader.line_num, row))
    except UnicodeDecodeError as error:
        raise InputError(path, "must be text in UTF-8; save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise InputError(path, f"is not a CSV file ({error})") from error
    if not rows:
        raise InputError(path, "has no rows")
    return header, rows


def check_output(path: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Refuse a path that cannot be written to, before any work is done for it.

    Parameters
    ----------
    inputs : iterable of str or Path, optional
        Files that the work reads. The output must be none of them, by any of its names or links.

    Raises
    ------
    InputError
        For a folder that does not exist, a file that cannot be written, or an input.
    """
    path = Path(path)
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise InputError(path, "cannot be written (folder does not exist)")
        if path.is_dir():
            raise InputError(path, "cannot be written (is a folder)")
        writable = os.access(path if path.exists() else folder, os.W_OK)
    except OSError as error:  # a name that is too long
        raise InputError(path, f"cannot be written ({error.strerror})") from error
    if not writable:
        raise InputError(path, "cannot be written (permission denied)")
    for source in inputs:
        if path.exists() and os.path.exists(source) and os.path.samefile(path, source):
            named = "an input" if Path(source) == path else f"the same file as the input {source}"
            raise InputError(path, f"cannot be written (is {named})")


def write_whole(path: str | Path, text: str) -> None:
    """Write a file in UTF-8, or replace it; the previous content is kept when that fails.

    Raises
    ------
    OSError
        When the system refuses to write.
    """
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give the path of a file beside another, which it replaces if the block ends without error.

    Yields Path: with the same suffix; a file there is removed after an error. A device or a pipe
    cannot be replaced, and is given itself.

    Parameters
    ----------
    path : str or Path
        The target of a symbolic link is replaced, and not the link.

    Raises
    ------
    OSError
        When the system refuses to replace the file.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        yield path
        return
    # Named after the process: no other file, least of all an input, has this name.
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        if part.exists():
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)
