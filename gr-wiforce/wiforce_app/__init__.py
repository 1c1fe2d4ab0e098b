# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, one module per subcommand."""

import os

# Threads only slow down matrices as small as ours. To be set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
