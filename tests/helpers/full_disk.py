# SPDX-License-Identifier: GPL-3.0-or-later
"""A disk that is soon full, for one process."""

import os
import resource


def room_for(size):
    """What a process calls first that may write so many bytes to each file.

    It must not compile what it imports: Python does not check how much of the bytecode could be
    written, so that later processes would fail on its first part.
    """

    def limit():
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit
