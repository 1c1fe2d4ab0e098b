# SPDX-License-Identifier: GPL-3.0-or-later
"""From the ratios R of groups to readings: flags, gaps, tare, and what is left empty."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.estimators import RatioUnfolder
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.press.evidence import PressEvidence
from gnuradio.wiforce.press.explanations import filter_of
from gnuradio.wiforce.press.readout import Readout
from gnuradio.wiforce.press.sensor_readout import SensorReadout
from gnuradio.wiforce.press.sensor_state import SensorState
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.signal.carrier import wrap_deg
from plain import averaged_groups

PERIOD_S = 0.036
CARRIER_HZ = 900e6
MODEL = load_sensor("wiforce-900mhz")
UNTOUCHED = np.array(MODEL.untouched_deg(CARRIER_HZ))


def ratios_of(force_n, location_mm):
    """R of both ends by definition; untouched below the onset."""
    return np.exp(1j * np.radians(MODEL.phases_deg(force_n, location_mm, CARRIER_HZ) - UNTOUCHED))


def group_of(index, ratios, std_deg=0.05, missing=0, reference=False, **more):
    """One group behind the average: ``ratios`` and ``std_deg`` (2,) or numbers."""
    group = averaged_groups(
        np.broadcast_to(np.asarray(ratios, complex), (1, 2)),
        index=[index],
        missing=np.array([missing]),
        snr_db=np.array([[7.0, 8.0]]),
        in_reference=np.full((1, 2), reference),
        phase_std_deg=np.broadcast_to(np.asarray(std_deg, float), (1, 2)),
    )
    shapes = {name: np.shape(getattr(group, name)) for name in more}
    return group.having(**{name: np.reshape(more[name], shapes[name]) for name in more})


def make_readout():
    evidence = PressEvidence(MODEL, CARRIER_HZ, np.zeros(2), PERIOD_S)
    state = SensorState(lambda: filter_of(MODEL, CARRIER_HZ, 0.0), evidence)
    return Readout({"s0": SensorReadout(MODEL, CARRIER_HZ, 0.0, PERIOD_S, state)}, PERIOD_S)


def scaled(group, by):
    """The same group with ratios multiplied."""
    return group.having(ratios=by * group.ratios)


def readings_of(readout, groups):
    """Readings of groups given one after the other, the last one included."""
    return [r for group in groups for r in readout.process(group)] + readout.flush()


def press(first, last, groups, **how):
    """Groups of an untouched sensor that is pressed from ``first`` to ``last``."""
    touched = ratios_of(4.0, 35.0)
    return [
        group_of(g, touched if first <= g <= last else 1.0, reference=g < 5, **how)
        for g in range(groups)
    ]


def test_readout_press_is_read_at_its_force_and_location():
    readings = readings_of(make_readout(), press(20, 29, 40))
    assert [r.touch for r in readings] == [int(20 <= g <= 29) for g in range(40)]
    assert [r.time_s for r in readings] == pytest.approx((np.arange(40) + 0.5) * PERIOD_S)
    held = readings[22]
    assert held.flags == () and held.snr_db == 7.0
    assert held.force_n == pytest.approx(4.0, abs=4 * held.force_std_n)
    assert held.location_mm == pytest.approx(35.0, abs=0.2)
    psi = MODEL.phases_deg(4.0, 35.0, CARRIER_HZ)
    assert [held.phase1_deg, held.phase2_deg] == pytest.approx(list(psi), abs=1e-6)
    for r in readings[:20]:
        assert r.force_n is r.location_mm is None
        assert wrap_deg([r.phase1_deg, r.phase2_deg] - UNTOUCHED) == pytest.approx([0, 0], abs=1e-6)


def test_readout_flags_the_reference_and_where_a_press_may_begin_or_end():
    readings = readings_of(make_readout(), press(20, 29, 40))
    assert [("reference" in r.flags) for r in readings] == [g < 5 for g in range(40)]
    flagged = {g for g, r in enumerate(readings) if "transition" in r.flags}
    assert {20, 29} <= flagged <= {20, 29, 30}


def test_readout_gives_a_group_when_the_next_is_known():
    readout, came = make_readout(), []
    for group in press(20, 29, 40):
        came.append([r.group for r in readout.process(group)])
    assert came == [[], *([g - 1] for g in range(1, 40))]


@pytest.mark.parametrize("at_once", [False, True])
def test_readout_second_of_two_groups_that_dip_is_flagged_transition(at_once):
    """A press that is replaced within two groups by another was read between them."""
    groups = press(20, 39, 40)
    for g, level in ((30, 0.75), (31, 0.85)):
        groups[g] = scaled(groups[g], level)
    groups = [Groups.concatenate(groups)] if at_once else groups
    flags = [r.flags for r in readings_of(make_readout(), groups)]
    changed = [g for g in range(21, 38) if "transition" in flags[g]]
    assert 30 in changed and flags[31] and flags[28] == flags[33] == ()


def test_readout_magnitude_dip_within_the_noise_is_not_flagged():
    groups = press(20, 39, 40, std_deg=2.5)
    groups[30] = scaled(groups[30], 0.9)
    assert "transition" not in readings_of(make_readout(), groups)[30].flags


@pytest.mark.parametrize(
    "clock, std_deg, ratio, flags",
    [
        ({"locked": False}, 0.05, 1.0, ("weak",)),
        ({}, np.inf, 1.0, ("weak",)),
        ({}, 0.05, 0.0, ("weak",)),
        ({"overlapping": True}, 0.05, 1.0, ("inconsistent",)),
        ({"late_reference": [True, True]}, np.inf, 1.0, ("weak", "inconsistent")),
    ],
)
def test_readout_unreadable_group_has_no_touch_and_no_numbers(clock, std_deg, ratio, flags):
    """No tag, no reference, or switches that are on together: nothing is invented."""
    (reading,) = readings_of(make_readout(), [group_of(0, ratio, std_deg, **clock)])
    assert reading.flags == flags
    numbers = (reading.touch, reading.force_n, reading.location_mm, reading.phase1_deg)
    assert numbers == (None, None, None, None) and reading.snr_db is None


def test_readout_uncertain_phase_is_flagged_weak():
    strong, weak = (readings_of(make_readout(), press(9, 9, 9, std_deg=s))[7] for s in (1.0, 3.5))
    assert "weak" not in strong.flags and "weak" in weak.flags


def test_readout_after_a_tare_counts_groups_as_untouched():
    readout = make_readout()
    moved = np.exp(1j * np.radians([25.0, 25.0]))
    groups = [group_of(g, moved if g >= 10 else 1.0, reference=g < 5) for g in range(20)]
    readings_of(readout, groups)
    readout.sensors["s0"].state.claim_untouched(forced=False)
    step = {"new_reference": True, "reference_step": moved}
    first = group_of(20, 1.0, reference=True, **step)
    reading = readings_of(readout, [first])[0]
    assert reading.touch == 0 and "moved" not in reading.flags
    assert wrap_deg([reading.phase1_deg, reading.phase2_deg] - UNTOUCHED) == pytest.approx(
        [0, 0], abs=1e-3
    )


def test_readout_motion_of_the_tag_is_flagged_moved():
    turned = np.exp(1j * np.radians([10.0, 10.0]))
    groups = [group_of(g, turned if g >= 20 else 1.0, reference=g < 5) for g in range(30)]
    readings = readings_of(make_readout(), groups)
    assert [g for g, r in enumerate(readings) if "moved" in r.flags] == [20]
    assert not any(r.touch for r in readings)


def test_readout_steps_of_the_paper_add_up():
    """Each group against the one before: the touch must stay after its first group."""
    changes = press(20, 29, 40)
    steps = changes[:1] + [
        scaled(group, 1 / before.ratios)
        for before, group in zip(changes[:-1], changes[1:], strict=True)
    ]
    unfolder = RatioUnfolder("step")
    readings = readings_of(make_readout(), map(unfolder.process, steps))
    assert [r.touch for r in readings] == [int(20 <= g <= 29) for g in range(40)]
    assert readings[25].location_mm == pytest.approx(35.0, abs=0.2)


@pytest.mark.parametrize("location_mm", [36, 41, 44])
@pytest.mark.parametrize("wider_mm", [8, 40])
def test_readout_contact_wider_than_calibrated_is_flagged_as_long_as_it_is_held(
    wider_mm, location_mm
):
    """Both ends change alike, as by a turn of the tag; 4 mm more are those of a harder press."""
    degrees_per_mm = 2 * 360 * CARRIER_HZ / 299792458.0 / 1000
    psi = MODEL.phases_deg(4.0, location_mm, CARRIER_HZ) + degrees_per_mm * wider_mm / 2
    assert_flagged_while_held(psi)


@pytest.mark.parametrize("fingers_mm", [(25, 55), (30, 50), (35, 45), (20, 60)])
def test_readout_two_fingers_are_flagged_as_long_as_they_press(fingers_mm):
    first, second = (MODEL.phases_deg(4.0, each, CARRIER_HZ) for each in fingers_mm)
    assert_flagged_while_held(np.array([first[0], second[1]]))


def assert_flagged_while_held(psi):
    """Groups with these phases, which no press of the model has, are touched and flagged."""
    rng = np.random.default_rng(1)
    ratio = np.exp(1j * np.radians(psi - MODEL.untouched_deg(CARRIER_HZ)))
    noise = np.radians(0.1) * (rng.standard_normal((100, 2)) + 1j * rng.standard_normal((100, 2)))
    groups = [
        group_of(g, (ratio if 20 <= g < 80 else 1.0) + noise[g], 0.1, reference=g < 13)
        for g in range(100)
    ]
    readings = readings_of(make_readout(), groups)
    assert all(r.flags for r in readings[20:80])
    assert not any(r.flags for r in readings[82:])


def test_readout_press_within_the_reference_is_read_all_the_same():
    """Before and after it the phases are those of the untouched sensor, whatever their mean is."""
    ratios = np.ones((30, 2), complex)
    ratios[3:5] = ratios_of(4.0, 55.0)
    ratios /= ratios[:8].mean(axis=0)
    groups = [group_of(g, ratios[g], reference=g < 8) for g in range(30)]
    readout = make_readout()
    readings = readings_of(readout, groups)
    assert [r.touch for r in readings] == [0] * 3 + [1] * 2 + [0] * 25
    assert not any(r.flags for r in readings[8:])
    assert readings[4].force_n == pytest.approx(4.0, abs=0.1)
    readout.sensors["s0"].state.claim_untouched(forced=False)
    step = {"new_reference": True, "reference_step": ratios[[8]]}
    fresh = [group_of(30 + g, 1.0, reference=g < 8, **(step if g == 0 else {})) for g in range(12)]
    assert not any(set(r.flags) - {"reference"} for r in readings_of(readout, fresh))


def test_readout_group_before_an_unknown_reference_is_what_it_was():
    """What follows cannot say more about it; it was read as if nothing had been known."""
    groups = press(20, 39, 40)
    step = {"new_reference": True, "reference_step": np.full(2, np.nan)}
    groups[30] = group_of(30, groups[30].ratios, **step)
    readings = readings_of(make_readout(), groups)
    assert readings[29].touch == 1
    assert readings[29].force_n == pytest.approx(4.0, abs=0.1)
    assert "ambiguous" in readings[35].flags


def test_readout_late_reference_is_flagged_inconsistent():
    groups = [
        group.having(late_reference=np.full((1, 2), g < 9))
        for g, group in enumerate(press(5, 8, 14))
    ]
    flagged = ["inconsistent" in r.flags for r in readings_of(make_readout(), groups)]
    assert flagged == [True] * 9 + [False] * 5


def test_readout_motion_while_touched_widens_what_is_stated():
    """Another press would show the same phases: the reading lies between both."""
    groups = press(10, 29, 40)
    for g in range(20, 30):
        groups[g] = scaled(groups[g], np.exp(-5j * np.pi / 180))
    readings = readings_of(make_readout(), groups)
    for r in readings[20:29]:
        assert abs(r.force_n - 4.0) < 5 * r.force_std_n
        assert abs(r.location_mm - 35.0) < 5 * r.location_std_mm
    assert readings[25].force_std_n > 1.5 * readings[15].force_std_n
