# SPDX-License-Identifier: GPL-3.0-or-later
"""Type annotations of the package are complete and consistent; pyproject.toml has the rules."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(
    not np.__version__.startswith("1."), reason="the annotations of NumPy 2 have other types"
)
def test_package_annotations_pass_mypy(pytestconfig):
    """Editors complete and check calls by the annotations: wrong ones mislead."""
    # Kept from run to run: a run without changes then takes a second instead of ten.
    cache = pytestconfig.cache.mkdir("mypy")
    assert importlib.util.find_spec("mypy"), "mypy is missing: ./bootstrap installs it"
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", str(cache)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
