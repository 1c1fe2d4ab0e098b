# SPDX-License-Identifier: GPL-3.0-or-later
"""A short press, which the tests of chains and of the reader read."""

import pytest
from gnuradio import wiforce
from press_capture import SCENE, press_codes


@pytest.fixture(scope="session")
def codes(tmp_path_factory):
    """ADC codes of the press, int16 pairs; shape (n, 2)."""
    return press_codes(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="session")
def plan():
    return wiforce.plan(SCENE)
