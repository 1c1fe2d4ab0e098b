# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce design`: what a line to build has, and what its tag's firmware needs."""

import json

import pytest
from command_runs import run_command


def test_design_of_the_paper_is_the_default():
    done = run_command("design", "--clock-hz", "1035", "--json")
    found = json.loads(done.stdout)
    assert found["impedance_ohm"] == pytest.approx(59.5, abs=0.1)
    assert found["matched_height_mm"] == pytest.approx(0.496, abs=0.001)
    first, second = found["carriers"]
    assert first["phase_deg_per_mm"] == pytest.approx(720 * 900e6 / 299_792_458e3, rel=1e-9)
    assert second["repeats_mm"] == pytest.approx(62.46, abs=0.01)
    assert found["timer"]["steps"] == 242 and found["timer"]["prescaler"] == 1


def test_filled_gap_lowers_the_impedance_and_turns_faster():
    """Half of the elastomer's effect would shift every location of a sensor."""
    options = "--permittivity", "2.8", "--frequency-hz", "915e6", "--ground-mm", "100"
    found = json.loads(run_command("design", *options, "--json").stdout)
    # Hammerstad and Jensen's equations in scikit-rf: 37.77 ohm over a wide ground
    assert found["impedance_ohm"] == pytest.approx(37.77, rel=2e-3)
    (carrier,) = found["carriers"]
    plain = 720 * 915e6 / 299_792_458e3
    assert carrier["phase_deg_per_mm"] == pytest.approx(
        plain * found["effective_permittivity"] ** 0.5, rel=1e-9
    )
    assert 2.0 < found["effective_permittivity"] < 2.8
