# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported by flowgraphs of Companion: bad input ends them with its sentence, not a traceback.

Whoever runs such a flowgraph has not written its Python, and would look for a fault there.
"""

import sys
from types import TracebackType

from ..errors import InputError

_others = sys.excepthook


def _show(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if isinstance(error, InputError):
        print(error, file=sys.stderr)
    else:
        _others(kind, error, trace)


sys.excepthook = _show
