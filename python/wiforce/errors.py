# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that the project raises for bad input and for output that cannot be written."""

import difflib
import errno
import re
import sys
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any

_DISK_ERRORS = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO)
_MOST_CHARACTERS = 80  # of a value in a message
_OWN = "gnuradio.wiforce"
# The compiled module that only a build with GNU Radio has.
_MODULE_WITH_GNURADIO = f"{_OWN}.wiforce_python"


class InputError(ValueError):
    """Bad input: one line that says where it is, which rule it breaks and the value given.

    Parameters
    ----------
    where : str or path
        File and key, file and row, option or parameter.
    rule : str
        What is required, for example ``"must be a positive integer"``.
    value : object, optional
        The value given instead.

    Attributes
    ----------
    where : str
        As given.

    Examples
    --------
    >>> raise InputError("frame_length", "must be at least 320", 64)
    Traceback (most recent call last):
    ...
    gnuradio.wiforce.errors.InputError: frame_length: must be at least 320, got 64
    """

    def __init__(self, where: object, rule: str, *value: object) -> None:
        self.where = str(where) or "''"  # an empty name must be seen
        self._what = rule + (f", got {_short(value[0])}" if value else "")
        super().__init__(f"{self.where}: {self._what}")

    @property
    def rule(self) -> str:
        """The rule that is broken, with the value."""
        return self._what

    def renamed(self, names: Mapping[str, str]) -> "InputError":
        """The same error with the caller's name of each parameter, such as a key of a scene."""
        return type(self)(names.get(self.where, self.where), self._what)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the text of the value, which itself may not be picklable."""
        return type(self), (self.where, self._what)


class OutputError(OSError):
    """Output that cannot be written to its end: one line that says where, and why."""

    def __init__(self, where: object, rule: str) -> None:
        self._where, self._rule = str(where), rule
        super().__init__(f"{where}: {rule}")

    @property
    def reason(self) -> str:
        """What the system reported, without the file and what is kept of it."""
        return self._rule.partition("(")[2].partition(")")[0] or self._rule

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._where, self._rule)


def unwritable(where: object, error: OSError) -> OutputError | InputError:
    """The error to raise when the system refuses to write a file: of the disk, or of the path."""
    kind = OutputError if error.errno in _DISK_ERRORS else InputError
    return kind(where, f"cannot be written ({error.strerror or error})")


def name_rule(kind: str, known: Iterable[str], given: str) -> str:
    """The rule that a name of something shipped breaks, with the name that was probably meant."""
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=0.5)
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"must be a .yaml file or a shipped {kind} ({meant}gr-wiforce list shows all)"


def gnuradio_rule(error: ImportError) -> str | None:
    """The rule that an installation without GNU Radio, or without our blocks, breaks.

    None when something else is missing, such as a name in our own package.
    """
    module = error.name or ""
    # `from gnuradio import gr` finds the namespace package that holds this module.
    absent = re.match(r"cannot import name '(\w+)' from 'gnuradio'", str(error))
    if absent:
        module = f"gnuradio.{absent[1]}"
    if module == _OWN or module.startswith(f"{_OWN}."):
        if module != _MODULE_WITH_GNURADIO:
            return None
    elif module.partition(".")[0] not in ("gnuradio", "pmt"):
        return None
    return (
        "needs GNU Radio and gr-wiforce built with it, which pip does not install "
        f"(no module {module})"
    )


def _short(value: object) -> str:
    if getattr(value, "shape", None) == () and hasattr(value, "item"):
        value = value.item()  # NumPy 2 shows the types of its numbers
    text = " ".join(repr(value).split())
    return text if len(text) <= _MOST_CHARACTERS else text[: _MOST_CHARACTERS - 3] + "..."


def printable(text: str) -> str:
    """A text whose line breaks, which names of files may contain, are replaced by spaces."""
    return "".join(c if c.isprintable() else " " for c in text)


def end_in_one_line() -> None:
    """Let bad input end the program with its sentence, not a traceback.

    For flowgraphs of Companion: whoever runs one has not written its Python, and would look for a
    fault there. What Companion can check it does before, but a device that does not answer is known
    on opening only. Other programs keep their tracebacks, which say which line to correct.
    """
    sys.excepthook = _show


def _show(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """As ``sys.excepthook``; other errors are faults, whose trace is needed."""
    if isinstance(error, InputError):
        print(error, file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)
