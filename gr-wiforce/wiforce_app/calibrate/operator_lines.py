# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines that a person types while other work goes on."""

import os
import select

_WAIT_S = 0.05
_CHUNK_BYTES = 4096


class OperatorLines:
    """Reads lines of a terminal or a pipe without blocking other work.

    ``descriptor``: standard input by default.
    """

    def __init__(self, descriptor=0):
        self._descriptor = descriptor
        self._rest, self._ended = b"", False

    def next(self, idle):
        """Wait for a line.

        Returns str or None: without its end; None at the end of input.

        ``idle``: called about 20 times per second meanwhile.
        """
        while b"\n" not in self._rest:
            if self._ended:
                return None
            idle()
            if select.select([self._descriptor], [], [], _WAIT_S)[0]:
                data = os.read(self._descriptor, _CHUNK_BYTES)
                self._ended = not data
                # A last line counts without its end as well.
                self._rest += data or (b"\n" if self._rest else b"")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()
