# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes of this package beside the command: of a radio, and of the page."""

import os
import subprocess
import sys
from pathlib import Path


def spawned(module: str, *descriptors: int) -> subprocess.Popen[bytes]:
    """A process that runs a module of this package, whose arguments are open descriptors."""
    packages = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, packages)), "PYTHONSAFEPATH": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", module, *map(str, descriptors)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,  # GNU Radio logs there
        env=os.environ | environment,
        pass_fds=descriptors,
    )
