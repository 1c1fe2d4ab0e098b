# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, a folder per task: `main` lists the subcommands and their modules.

`scenes`, `plan`, `calibrate`, `read` and `live` are the tasks of a measurement, in their order;
`radio` is the devices of `live`, and `web` its page in a browser. `evaluate` and `bench` measure
the receiver itself. `shell` is what all of them share.
"""

import os
from pathlib import Path

import gnuradio

from .shell.blas import settings

# To be set before NumPy is imported.
for _name, _value in settings().items():
    os.environ.setdefault(_name, _value)

# The library that was installed with this command. GNU Radio lists its own folder, where
# another release of the library may be, before those of other packages.
_own = str(Path(__file__).parent.parent / "gnuradio")
if isinstance(gnuradio.__path__, list) and _own in gnuradio.__path__:
    gnuradio.__path__.remove(_own)
    gnuradio.__path__.insert(0, _own)
