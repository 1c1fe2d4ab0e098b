# SPDX-License-Identifier: GPL-3.0-or-later
"""The live reader for minutes; not part of the default run."""

import pytest
from qa_live import SideBySide

SECONDS = 180


@pytest.mark.timeout(3000)
def test_presses_and_faults_are_read_for_minutes(tmp_path):
    run = SideBySide(tmp_path, SECONDS)
    run.check_clean(SECONDS)
    run.check_faulty()
