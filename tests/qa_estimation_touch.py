# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch, tare and motion, from phase changes alone."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.motion import TouchedMotion
from gnuradio.wiforce.estimation.touch import TouchDetector
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.signal.carrier import wrap_deg

PERIOD_S = 0.036
MODEL = load_sensor("line-900mhz")
UNTOUCHED = np.array(MODEL.untouched_deg())


def turned(force_n, location_mm):
    """Phase changes of a press."""
    return wrap_deg(MODEL.phases_deg(force_n, location_mm) - UNTOUCHED)


@pytest.fixture
def detector():
    forces, locations = np.geomspace(0.9, 9, 40), np.arange(0, 80.5)
    grid = np.stack(np.meshgrid(forces, locations), -1).reshape(-1, 2)
    return TouchDetector(turned(grid[:, 0], grid[:, 1]), PERIOD_S)


def run(detector, phases, std_deg, rng=None, reference=0):
    """Decisions over phases (groups, 2) to which noise of ``std_deg`` is added."""
    noise = 0 if rng is None else std_deg * rng.standard_normal(phases.shape)
    return [
        detector.update(g * PERIOD_S, pair, (std_deg, std_deg), g < reference)
        for g, pair in enumerate(wrap_deg(phases + noise).tolist())
    ]


def touches(decisions):
    return np.array([-1 if d.touch is None else d.touch for d in decisions])


# snr_db -15 is gamma -2 dB: .75 deg per group of 625.
@pytest.mark.parametrize("std_deg", [0.02, 0.2, 0.75, 2.0, 5.0])
def test_touch_untouched_groups_false_alarms_stay_below_one_percent(detector, std_deg):
    decisions = run(detector, np.zeros((4000, 2)), std_deg, np.random.default_rng(1))
    assert np.mean(touches(decisions) == 1) <= 0.01
    assert np.mean([d.moved for d in decisions]) <= 0.002


@pytest.mark.parametrize("location_mm", [12.0, 40.0, 68.0])
@pytest.mark.parametrize("force_n", [1.2, 3.0, 7.0])
@pytest.mark.parametrize("std_deg", [0.05, 0.75])
def test_touch_press_is_detected_from_first_to_last_group(detector, force_n, location_mm, std_deg):
    phases = np.zeros((90, 2))
    phases[30:60] = turned(force_n, location_mm)
    decisions = run(detector, phases, std_deg, np.random.default_rng(2), reference=13)
    assert np.array_equal(touches(decisions) == 1, (np.arange(90) >= 30) & (np.arange(90) < 60))
    assert not any(d.moved for d in decisions)


def test_tare_follows_slow_drift_and_holds_during_a_touch(detector):
    drift = np.outer(np.linspace(0, 30, 300), [1.0, 1.0])
    phases = drift.copy()
    phases[200:] = drift[200] + turned(4.0, 30.0)
    decisions = run(detector, phases, 0.2, np.random.default_rng(3), reference=13)
    followed = np.array([d.drift_deg for d in decisions])
    assert not np.any(touches(decisions)[:200]) and np.all(touches(decisions)[200:])
    # A quarter of the change of one group is left where the drift is steady.
    assert np.max(np.abs(followed[60:200] - drift[60:200])) < 0.5
    assert np.ptp(followed[200:], axis=0) == pytest.approx([0, 0], abs=1e-12)


def test_tare_of_a_still_tag_adds_little_noise(detector):
    decisions = run(detector, np.zeros((1000, 2)), 0.3, np.random.default_rng(4))
    drift = np.array([d.drift_deg for d in decisions])[100:]
    # The mean over a second of groups: .3/sqrt(28), against .3/sqrt(13) of the reference.
    assert np.sqrt(np.mean(drift**2)) < 0.3 / np.sqrt(28) * 1.6


@pytest.mark.parametrize("step_deg", [25.0, -60.0, 150.0])
def test_touch_common_step_is_motion(detector, step_deg):
    phases = np.zeros((80, 2))
    phases[40:] = step_deg
    decisions = run(detector, phases, 0.3, np.random.default_rng(5), reference=13)
    # One group alone may be a press that began inside it.
    assert [g for g, d in enumerate(decisions) if d.moved] == [40, 41]
    assert not np.any(touches(decisions))
    assert decisions[-1].drift_deg == pytest.approx([step_deg] * 2, abs=0.5)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_touch_press_beginning_inside_a_group_is_not_motion(detector, share):
    """The group's phase is that of a chord, and may turn both ends alike."""
    touched = turned(4.0, 45.0)
    chord = (1 - share) + share * np.exp(1j * np.radians(touched))
    phases = np.zeros((60, 2))
    phases[30] = np.degrees(np.angle(chord))
    phases[31:] = touched
    decisions = run(detector, phases, 0.1, np.random.default_rng(8), reference=13)
    assert np.all(touches(decisions)[31:] == 1)
    assert np.max(np.abs(decisions[-1].drift_deg)) < 0.2


def test_tare_ignores_a_group_without_information(detector):
    for g in range(40):
        spoilt = g == 15
        phases, std_deg = ((-15.0, 70.0), 500.0) if spoilt else ((0.0, 0.0), 0.02)
        decision = detector.update(g * PERIOD_S, phases, (std_deg, std_deg))
        assert np.allclose(decision.drift_deg, 0, atol=0.01)


def test_tare_ignores_weak_groups_that_look_like_motion(detector):
    run(detector, np.zeros((20, 2)), 0.05)
    run(detector, np.full((3, 2), 95.0), 8.0)
    decisions = run(detector, np.zeros((5, 2)), 0.05)
    assert touches(decisions).tolist() == [0] * 5
    assert not np.any([d.drift_deg for d in decisions])


def test_touch_press_after_motion_is_relative_to_the_new_phases(detector):
    phases = np.zeros((100, 2))
    phases[30:] += 25.0
    phases[70:] += turned(3.0, 25.0)
    decisions = run(detector, phases, 0.2, np.random.default_rng(6), reference=13)
    assert np.all(touches(decisions)[70:] == 1)
    measured = wrap_deg(phases[80] - decisions[80].drift_deg)
    assert measured == pytest.approx(turned(3.0, 25.0), abs=0.3)


def test_touch_after_what_only_looked_like_motion_is_flagged_until_untouched(detector):
    """A touch at mid-line ends and the next one begins within two groups: no phases of both."""
    press = turned(1.5, 40.0)
    phases = np.zeros((50, 2))
    phases[20:27], phases[27], phases[28], phases[29:36] = press, 0.2 * press, 0.1 * press, press
    phases[40:] = press
    decisions = run(detector, phases, 0.05, np.random.default_rng(5), reference=13)
    moved = np.array([d.moved for d in decisions])
    assert decisions[28].drift_deg != (0, 0)  # what the next touch would be read with
    assert np.all(touches(decisions)[29:36] == 1) and np.all(moved[27:36]) and not moved[:27].any()
    assert np.all(touches(decisions)[40:] == 1) and not moved[40:].any()
    assert decisions[-1].drift_deg == pytest.approx((0, 0), abs=0.2)


@pytest.mark.parametrize("share", [(0.2, 0.6), (0.3, 0.7), (0.25, 0.5, 0.75)])
def test_touch_at_mid_line_that_begins_over_several_groups_is_no_motion(detector, share):
    """Both phases change alike from group to group; the tare followed them into the press."""
    press = turned(4.0, 40.0)
    phases = np.zeros((60, 2))
    phases[20:40] = press
    for group, part in enumerate(share, 20):
        phases[group] = np.degrees(np.angle(1 - part + part * np.exp(1j * np.radians(press))))
    decisions = run(detector, phases, 0.3, np.random.default_rng(5), reference=13)
    whole = slice(20 + len(share), 40)
    assert np.all(touches(decisions)[whole] == 1)
    assert all(d.moved for d in decisions[20:40])
    assert not np.any(touches(decisions)[40:]) and not any(d.moved for d in decisions[40:])
    assert decisions[-1].drift_deg == pytest.approx((0, 0), abs=0.3)


def test_tare_after_motion_leaves_out_the_group_in_which_a_touch_ends(detector):
    """It was the only group of the tare, and the next press was read from it."""
    phases = np.zeros((60, 2))
    phases[20:] += 25.0
    phases[22:30] += turned(3.0, 25.0)
    phases[30] += 3.0
    phases[34:] += turned(3.0, 25.0)
    decisions = run(detector, phases, 0.05, np.random.default_rng(5), reference=13)
    assert np.all(touches(decisions)[34:] == 1)
    assert decisions[40].drift_deg == pytest.approx((25.0, 25.0), abs=0.3)


def test_touch_right_after_a_motion_states_the_error_of_the_tare(detector):
    """The tare extrapolates the motion beyond its end, and the press was read from there."""
    phases = np.zeros((100, 2))
    phases[40:] += np.clip(0.9 * np.arange(60)[:, None], 0, 9)
    phases[63:] += turned(3.0, 25.0)
    decisions = run(detector, phases, 0.1, np.random.default_rng(5), reference=13)
    error = np.abs(np.array(decisions[63].drift_deg) - 9.0)
    std = np.array(detector.drift_std_deg(63.5 * PERIOD_S))
    assert np.all(error > 1) and np.all(error < 2 * std) and not decisions[63].moved


@pytest.mark.parametrize("std_deg", [0.05, 0.5, 2.0])
def test_touch_of_a_still_tag_states_no_error_of_the_tare(detector, std_deg):
    run(detector, np.zeros((40, 2)), std_deg, np.random.default_rng(5), reference=13)
    assert detector.drift_std_deg(40 * PERIOD_S) == (0, 0)


def test_touch_without_phases_is_unknown(detector):
    run(detector, np.zeros((30, 2)), 0.2)
    decision = detector.update(1.2, (0.0, 0.0), (0.2, np.inf))
    assert decision.touch is None and not decision.moved


def test_tare_on_request_resets_drift_and_touch(detector):
    phases = np.concatenate([np.full((40, 2), 3.0), np.tile(turned(3.0, 30.0) + 3.0, (10, 1))])
    assert run(detector, phases, 0.1)[-1].touch == 1
    detector.tare()
    decision = detector.update(2.0, (0.0, 0.0), (0.1, 0.1), True)
    assert decision.touch == 0 and decision.drift_deg == (0, 0)


@pytest.mark.parametrize("std_deg", [0.05, 0.75, 3.0])
def test_touch_press_within_the_reference_is_reported(detector, std_deg):
    ratios = np.ones((60, 2), complex)
    ratios[5:9] = np.exp(1j * np.radians(turned(4.0, 55.0)))
    phases = np.degrees(np.angle(ratios / ratios[:13].mean(axis=0)))
    decisions = run(detector, phases, std_deg, np.random.default_rng(5), reference=13)
    assert all(d.disturbed for d in decisions[6:])
    detector.tare()
    rng = np.random.default_rng(6)
    for _ in range(100):
        decisions = run(detector, np.zeros((20, 2)), std_deg, rng, reference=13)
        assert not any(d.disturbed for d in decisions)


def test_touch_slow_press_within_the_reference_is_reported(detector):
    """No two groups that follow each other differ much, but the mean is not that of untouched."""
    phases = np.zeros((40, 2))
    phases[:13, 0] = np.linspace(-12, 12, 13)
    assert run(detector, phases, 0.05, reference=13)[-1].disturbed


def motion_of(forces, locations, turn_deg, std_deg=0.05, seed=7):
    """Whether the tag is said to have moved, group by group of a touch; shape (n,)."""
    noise = std_deg * np.random.default_rng(seed).standard_normal((len(forces), 2))
    phases = MODEL.phases_deg(forces, locations) + turn_deg[:, None] + noise
    found = MODEL.invert(phases, std_deg=std_deg)
    motion, stds = TouchedMotion(), (std_deg, std_deg)
    groups = zip(phases.tolist(), found.location_mm.tolist(), strict=True)
    return np.array([motion.update(pair, stds, location, std_deg) for pair, location in groups])


def test_motion_step_while_touched_differs_from_a_change_of_force():
    steady, still = np.full(40, 4.0), np.zeros(40)
    step = np.where(np.arange(40) < 20, 0.0, -5.0)
    for location_mm in (25.0, 30.0, 50.0, 55.0):
        moved = motion_of(steady, np.full(40, location_mm), step)
        assert not moved[:20].any() and moved[20:].all()
    for location_mm in (20.0, 30.0, 37.0, 40.0, 43.0, 60.0):
        for forces in (np.linspace(1.5, 8, 40), np.where(np.arange(40) < 20, 3.0, 7.0)):
            assert not motion_of(forces, np.full(40, location_mm), still).any()
    slides = np.where(np.arange(40) < 20, 45.0, 47.0)
    assert not motion_of(steady, slides, still).any()


def test_motion_step_in_the_middle_of_the_line_is_not_detected():
    """Both cases rotate both ends by the same angle there, so they cannot be distinguished."""
    step = np.where(np.arange(40) < 20, 0.0, 5.0)
    assert not motion_of(np.full(40, 3.0), np.full(40, 40.0), step).any()


def test_motion_between_two_touches_is_not_motion_during_the_second():
    """A tag that was moved while untouched is read from its new place."""
    motion, std = TouchedMotion(), (0.05, 0.05)
    for phases, location_mm in (((40.0, 20.0), 25.0), ((35.0, 15.0), 26.0)):
        found = [motion.update(phases, std, location_mm, 0.05) for _ in range(3)]
        assert found == [False] * 3
        motion.forget()
