# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, one module per subcommand."""

import os
from pathlib import Path

import gnuradio

from .blas import settings

# To be set before NumPy is imported.
for _name, _value in settings().items():
    os.environ.setdefault(_name, _value)

# The library that was installed with this command. GNU Radio lists its own folder, where
# another release of the library may be, before those of other packages.
_own = str(Path(__file__).parent.parent / "gnuradio")
if isinstance(gnuradio.__path__, list) and _own in gnuradio.__path__:
    gnuradio.__path__.remove(_own)
    gnuradio.__path__.insert(0, _own)
