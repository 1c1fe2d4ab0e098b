# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries that only one feature needs, and how each is installed."""

import importlib
import importlib.util
from collections.abc import Iterable
from typing import Any

from ..errors import InputError

# By the name of the module: the package of Debian, where it has one, and that of PyPI.
_PACKAGES = {
    "bokeh": (None, "bokeh"),
    "csiread": (None, "csiread"),
    "foxglove": (None, "foxglove-sdk"),
    "matplotlib": ("python3-matplotlib", "matplotlib"),
    "mcap": (None, "mcap-ros2-support"),
    "mcap_ros2": (None, "mcap-ros2-support"),
    # Later releases replace the NumPy that GNU Radio was built with.
    "pyarrow": (None, '"pyarrow<24"'),
    "pylsl": (None, "pylsl"),
    "serial": ("python3-serial", "pyserial"),
    # Debian 12 has an older release, which reads Touchstone files otherwise.
    "skrf": (None, '"scikit-rf>=1.0"'),
    "tornado": (None, "bokeh"),
    "zmq": ("python3-zmq", "pyzmq"),
}


def optional_modules(where: object, names: Iterable[str]) -> list[Any]:
    """Import modules, or say in one line what must be installed for an option or file."""
    found: list[Any] = []
    missing: dict[str, Exception] = {}
    for name in names:
        try:
            found.append(importlib.import_module(name))
        except (ImportError, RuntimeError) as error:  # pylsl raises the latter without liblsl
            missing[name] = error
    if missing:
        raise _missing(where, missing) from next(iter(missing.values()))
    return found


def check_installed(where: object, names: Iterable[str]) -> None:
    """As :func:`optional_modules`, without the time that imports take; names without dots."""
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        raise _missing(where, missing)


def _missing(where: object, names: Iterable[str]) -> InputError:
    """The error that names the packages of missing modules, each once."""
    needed = list(dict.fromkeys(_PACKAGES[name.partition(".")[0]] for name in names))
    packages = [pypi for _, pypi in needed]
    ways = [f"pip install {' '.join(packages)}"]
    debian = [name for name, _ in needed if name is not None]
    if len(debian) == len(needed):
        ways.insert(0, f"apt install {' '.join(debian)}")
    rule = f"needs {' and '.join(each.strip(chr(34)) for each in packages)}: "
    ways.append("./bootstrap in a checkout")
    return InputError(where, rule + ", or ".join(ways))


def optional_module(name: str, where: object) -> Any:
    """Import one module, as :func:`optional_modules` does."""
    return optional_modules(where, [name])[0]
