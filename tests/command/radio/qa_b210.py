# SPDX-License-Identifier: GPL-3.0-or-later
"""A B210 by its arguments, with the gains of docs/radios.md (emulated_b210.cc)."""

import json
from pathlib import Path

import pytest
from live_runs import FRAMES, command

MODULE = Path(__file__).parents[3] / "build" / "libemulated_b210.so"

pytestmark = pytest.mark.skipif(not MODULE.exists(), reason="needs libuhd-dev when building")


@pytest.fixture
def b210(slow_device, monkeypatch):
    monkeypatch.setenv("LD_PRELOAD", str(MODULE))
    monkeypatch.setenv("SOFTWARE_N210", slow_device.address)
    return f"type=b200,{FRAMES}"


def test_check_of_a_b210_begins_at_the_gains_of_the_page(slow_scene, b210):
    check = ["check", "--scene", slow_scene, "--args", b210]
    status, out, said = command(*check, "--json")
    assert (status, said) == (0, ""), said
    found = json.loads(out)
    assert found["hardware"].startswith("B210, FE-RX1")
    assert found["settings"]["tx_gain_db"] == pytest.approx(30, abs=0.5)
    assert found["settings"]["rx_gain_db"] == pytest.approx(25, abs=0.5)
    assert found["advice"] == []
    status, _, said = command(*check, "--rx-gain", 77)
    assert status == 2 and "0 to 76" in said
