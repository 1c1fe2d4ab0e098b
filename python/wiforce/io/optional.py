# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries that only one feature needs."""

import importlib
from typing import Any

from ..errors import InputError


def optional_module(name: str, where: object, needs: str) -> Any:
    """Import a module, or say in one line what must be installed.

    Parameters
    ----------
    name : str
    where : str or path
        The option or file that needs it.
    needs : str
        The packages that have it, as ``pip install`` names them.

    Returns
    -------
    module

    Raises
    ------
    InputError
        When it is missing.

    Examples
    --------
    >>> optional_module("no_such_module", "--mcap", "no-such-package")
    Traceback (most recent call last):
    ...
    gnuradio.wiforce.errors.InputError: --mcap: needs a package: pip install no-such-package
    """
    try:
        return importlib.import_module(name)
    except (ImportError, RuntimeError) as error:  # pylsl raises the latter without liblsl
        plural = "packages" if " " in needs else "a package"
        raise InputError(where, f"needs {plural}: pip install {needs}") from error
