# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, one module per subcommand."""

import os

from .blas import settings

# To be set before NumPy is imported.
for _name, _value in settings().items():
    os.environ.setdefault(_name, _value)
