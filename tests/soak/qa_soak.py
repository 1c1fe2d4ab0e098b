# SPDX-License-Identifier: GPL-3.0-or-later
"""The soak test, for a minute of signal; for a day: build/run python3 tests/soak/run.py."""

import re
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.long
@pytest.mark.timeout(300)
def test_live_reader_with_whatever_happens_to_it_is_right_or_says_that_it_is_not():
    """A robot acts on readings without a flag, and on the state; nobody looks for weeks."""
    command = [sys.executable, Path(__file__).with_name("run.py"), "--short", "--loops", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "device lost and found 1 times" in done.stdout and "\n0 problems" in done.stdout
    # It has compared something.
    assert int(re.search(r"'unflagged touched': (\d+)", done.stdout)[1]) > 30
    assert int(re.search(r"(\d+) checks", done.stdout)[1]) >= 10
