# SPDX-License-Identifier: GPL-3.0-or-later
"""What bad input raises everywhere in the project, and what output that cannot be written."""

import errno

_NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO)


class InputError(ValueError):
    """Bad input: says in one line where it was found, which rule it broke and the value given.

    Parameters
    ----------
    where : str
        File and key, file and row, option or parameter.
    rule : str
        What is required, for example ``"must be a positive integer"``.
    value : object, optional
        What was given instead.
    """

    def __init__(self, where, rule, *value):
        given = f", got {_short(value[0])}" if value else ""
        super().__init__(f"{where}: {rule}{given}")

    def __reduce__(self):
        """Told by another process it is the same error."""
        return _told_again, (type(self), str(self))


class OutputError(OSError):
    """Output that cannot be written to its end: says in one line where, and why.

    Parameters
    ----------
    where : str
        File.
    rule : str
        What happened, and what is kept.
    """

    def __init__(self, where, rule):
        super().__init__(f"{where}: {rule}")


def unwritable(where, error):
    """What to raise when the system refuses to write a file: its disk, or its name, is to blame.

    Parameters
    ----------
    where : path
    error : OSError

    Returns
    -------
    OutputError or InputError
    """
    kind = OutputError if error.errno in _NO_ROOM else InputError
    return kind(where, f"cannot be written ({error.strerror or error})")


def _told_again(kind, text):
    error = kind.__new__(kind)
    error.args = (text,)
    return error


def _short(value, limit=80):
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."
