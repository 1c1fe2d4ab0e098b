# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of results, refused before any work is done for them."""

import os
from pathlib import Path

from gnuradio.wiforce.errors import InputError


def check_output(path):
    """Refuses a path that nothing can be written to.

    Raises
    ------
    InputError
        For a folder that is not there or a file that cannot be written.
    """
    path = Path(path)
    if not path.absolute().parent.is_dir():
        raise InputError(path, "folder does not exist")
    if not os.access(path if path.exists() else path.absolute().parent, os.W_OK) or path.is_dir():
        raise InputError(path, "cannot be written")
