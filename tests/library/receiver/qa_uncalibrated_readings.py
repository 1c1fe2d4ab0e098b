# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch and phases of a tag that lies still, read without the model of its sensor."""

import numpy as np
import pytest
from gnuradio.wiforce.press.sensor_readout import uncalibrated_readings
from plain import averaged_groups

UNTOUCHED = (-172.9, 170.0)


def readings(changes_deg, **arrays):
    """Readings of the second of two sensors whose phases change like this."""
    changes = np.asarray(changes_deg, float)
    count = len(changes)
    ratios = np.exp(1j * np.radians(np.hstack([np.zeros((count, 2)), changes])))
    groups = averaged_groups(ratios, index=10 + np.arange(count), **arrays)
    return uncalibrated_readings(groups, 1, "arm", UNTOUCHED, 0j, 0.036)


@pytest.mark.parametrize(
    ("change_deg", "touch"),
    [((0.3, -0.2), 0), ((3.0, 3.0), 0), ((25.0, 25.0), 1), ((-40.0, 2.0), 1), ((170.0, 190.0), 1)],
)
def test_touch_is_decided_by_the_change_alone(change_deg, touch):
    """A press in the middle of an unknown sensor would be taken for a motion of the tag."""
    (reading,) = readings([change_deg])
    assert reading.touch == touch and reading.sensor == "arm" and reading.flags == ()
    assert reading.time_s == pytest.approx(10.5 * 0.036)
    found = np.array([reading.phase1_deg, reading.phase2_deg])
    expected = np.array(UNTOUCHED) + change_deg
    assert np.allclose((found - expected + 180) % 360, 180) and np.all(np.abs(found) <= 180)


def test_groups_without_the_tag_have_no_touch_and_no_phases():
    locked = np.array([[True, True], [True, False], [False, True]])
    found = readings(np.full((3, 2), 30.0), locked=locked)
    assert [each.touch for each in found] == [1, None, 1]
    assert found[1].phase1_deg is None


@pytest.mark.parametrize(
    ("array", "flag"),
    [("in_reference", "reference"), ("reshaped", "moved"), ("late_reference", "inconsistent")],
)
def test_flags_are_those_of_the_sensors_own_ends(array, flag):
    raised = np.zeros((3, 4), bool)
    raised[1, 3] = raised[2, 0] = True
    found = readings(np.full((3, 2), 30.0), **{array: raised})
    assert [each.flags for each in found] == [(), (flag,), ()]


def test_groups_of_a_tare_gaps_and_saturation_are_flagged():
    """A press during a tare would be calibrated against the former reference."""
    raised = np.eye(3, dtype=int)
    found = readings(
        np.zeros((3, 2)), in_tare=raised[0] > 0, missing=raised[1], saturated=raised[2] > 0
    )
    assert [each.flags for each in found] == [("reference",), ("gap",), ("saturated",)]
    assert [each.group for each in found] == [10, 11, 12]
