# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported by flowgraphs of Companion: bad input ends them with its sentence, not a traceback.

Whoever runs such a flowgraph has not written its Python, and would look for a fault there. What
Companion can check it does before, but a device that does not answer is known on opening only.
A program that imports blocks for itself keeps its tracebacks, which say which line to correct.
"""

import sys
from types import TracebackType

from ..errors import InputError

_show_others = sys.excepthook


def _show(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """As ``sys.excepthook``; other errors are faults, whose trace is needed."""
    if isinstance(error, InputError):
        print(error, file=sys.stderr)
    else:
        _show_others(kind, error, trace)


sys.excepthook = _show
