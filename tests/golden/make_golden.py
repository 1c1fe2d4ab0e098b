# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores the readings of all cases, or of those named.

build/run python3 tests/golden/make_golden.py [CASE...]

Run only when readings are meant to change; the commit says how they changed and why.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parent.parent
sys.path[:0] = [str(TESTS / name) for name in ("golden", "robustness", "helpers")]
import cases  # noqa: E402

with tempfile.TemporaryDirectory() as folder:
    for case in sys.argv[1:] or cases.all_cases():
        np.savez_compressed(cases.FOLDER / "readings" / f"{case}.npz", **cases.make(case, folder))
        print(case)
