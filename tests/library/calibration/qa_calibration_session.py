# SPDX-License-Identifier: GPL-3.0-or-later
"""A guided calibration stores presses that held still, doubts others, and gives a sensor."""

import errno
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.session import (
    CalibrationSession,
    PressMeasurement,
    SessionPlan,
    Target,
    measure_press,
    measure_untouched,
    steady_deg,
)
from gnuradio.wiforce.calibration.tables import read_tap_csv
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.readings import EXPLANATION, RECEPTION
from gnuradio.wiforce.sensor import load_sensor
from guided_presses import HandHeldSensor

PLAN = SessionPlan("arm", 900e6)
LINE = load_sensor("line-900mhz")


@pytest.fixture
def session(tmp_path):
    return CalibrationSession(PLAN, tmp_path / "arm.taps.csv")


def press(force_n, location_mm, sweep=1, true_n=None, model=LINE, frequency_hz=900e6):
    """A measurement of `true_n` for which `force_n` was typed."""
    true_n = force_n if true_n is None else true_n
    phases = tuple(model.phases_deg(true_n, location_mm, frequency_hz).tolist())
    return PressMeasurement(location_mm, force_n, 0.01, phases, (0.1, 0.1), 14, sweep)


def untouched(offset_deg=0.0, model=LINE):
    phases = tuple((np.array(model.untouched_deg()) + offset_deg).tolist())
    return PressMeasurement(math.nan, 0.0, math.nan, phases, (0.1, 0.1), 14)


def measure_all(session, most=None):
    while most != 0 and (target := session.next_target()):
        session.add(press(target.force_n, target.location_mm, target.sweep))
        most = None if most is None else most - 1


def test_session_continues_where_it_was_interrupted(session):
    """A person would begin again after an hour of work."""
    session.add(untouched())
    measure_all(session, 17)
    before = session.measurements
    session = CalibrationSession(PLAN, session.path)
    assert len(session.presses) == 17
    assert session.next_target() == Target(30.0, 1, 3.5)
    for old, new in zip(before, session.measurements, strict=True):
        assert new.phase_deg == pytest.approx(old.phase_deg, abs=1e-4)
        assert (new.force_n, new.sweep, new.time_utc) == (old.force_n, old.sweep, old.time_utc)
    measure_all(session)
    assert session.done() == (60, 60)


def test_each_measurement_is_in_the_file_at_once(session, monkeypatch):
    """Pulling the plug would lose what was measured."""
    path, on_disk = session.path, []
    monkeypatch.setattr(os, "fsync", lambda file: on_disk.append(os.pread(file, 9999, 0)))
    assert not path.exists()
    for count in range(1, 4):
        measure_all(session, 1)
        assert len(path.read_text().splitlines()) == 1 + count
        assert path.read_bytes() == on_disk[-1]
    assert read_tap_csv(path, 900e6).force_n.tolist() == [1.0, 1.0, 1.5, 1.5, 2.0, 2.0]


@pytest.mark.parametrize(
    ("plan", "word", "other", "rule"),
    [
        (replace(PLAN, sensor="leg"), "", "", "row 2: sensor: must be of the sensor 'leg'"),
        (replace(PLAN, frequency_hz=915e6), "", "", "row 2: freq_mhz: must be 915"),
        (PLAN, ",1.5,", ",about 2,", "row 3: force_n: must be a number, got 'about 2'"),
        (PLAN, "phase1_deg", "phase_deg", "must be a new file, or one that `calibrate --live`"),
    ],
)
def test_other_file_is_refused_and_kept(session, plan, word, other, rule):
    """Phases of two sensors in one table would make a sensor that does not exist."""
    measure_all(session, 2)
    path = session.path
    before = path.read_text().replace(word, other)
    path.write_text(before)
    with pytest.raises(InputError, match=f"arm.taps.csv: {rule}"):
        CalibrationSession(plan, path)
    assert path.read_text() == before


def test_file_that_another_program_changed_is_kept(session):
    """Two sessions of one sensor would each remove the presses of the other."""
    CalibrationSession(PLAN, session.path).add(press(1.0, 20.0))
    with pytest.raises(InputError, match="arm.taps.csv: was changed by another program"):
        session.add(press(2.0, 20.0))
    assert len(CalibrationSession(PLAN, session.path).presses) == 1


def test_full_disk_keeps_the_rows_before(session, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    measure_all(session, 2)
    whole = session.path.read_text()
    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", full)
        with pytest.raises(OutputError, match="No space left on device"):
            measure_all(session, 1)
    assert session.path.read_text() == whole and len(session.presses) == 2
    measure_all(session, 1)
    assert len(session.presses) == 3


def test_untouched_phases_of_another_model_are_refused(session):
    """The scene got another model in between: its presses refer to other phases."""
    session.add(untouched())
    session.add(untouched(0.5))
    with pytest.raises(InputError, match="must have the phases of the session's start"):
        session.add(untouched(20.0))


def test_sweeps_rise_and_fall_and_are_distinguished(tmp_path):
    plan = SessionPlan("arm", 900e6, (30.0, 50.0), (1.0, 2.0, 4.0, 6.0, 8.0), sweeps=2)
    session = CalibrationSession(plan, tmp_path / "arm.taps.csv")
    asked = []
    while target := session.next_target():
        asked.append(target.force_n)
        session.add(press(target.force_n, target.location_mm, target.sweep))
    assert asked == 2 * [1, 2, 4, 6, 8, 8, 6, 4, 2, 1]
    table = read_tap_csv(tmp_path / "arm.taps.csv", 900e6)
    assert set(table.press) == {"1", "2"}


def test_model_is_that_of_calibrate_on_the_file(tmp_path):
    path = tmp_path / "arm.taps.csv"
    session = CalibrationSession(PLAN, path, {"form": "power", "ruler_std_mm": 0.3})
    session.add(untouched())
    measure_all(session)
    own = session.model("arm")
    other = calibrate(read_tap_csv(path, 900e6), "arm", form="power", ruler_std_mm=0.3)
    assert np.array_equal(own.carriers[0].coefficients_deg, other.carriers[0].coefficients_deg)
    assert own.ruler_std_mm == 0.3


def test_wrong_force_is_doubted_from_two_locations_on(session):
    assert session.doubts() == []
    session.add(untouched())
    for target in PLAN.targets()[:24]:
        true_n = 3.0 if (target.location_mm, target.force_n) == (30.0, 4.0) else None
        session.add(press(target.force_n, target.location_mm, true_n=true_n))
    assert len(session.doubts()) == 2
    assert all("phase of 4 N at location 30 mm, port" in each for each in session.doubts())


@pytest.mark.parametrize("name", ["line-2400mhz", "wiforce-900mhz"])
def test_honest_presses_are_neither_refused_nor_doubted(name, tmp_path):
    """A person errs by 5 % of the force and by some tenths of a millimetre."""
    model, rng = load_sensor(name), np.random.default_rng(3)
    frequency = model.frequencies_hz[0]
    errors_mm = dict(zip(PLAN.location_mm, 0.2 * rng.standard_normal(5), strict=True))
    plan = replace(PLAN, frequency_hz=frequency)
    session = CalibrationSession(plan, tmp_path / "arm.taps.csv", {"ruler_std_mm": 0.3})
    session.add(untouched(model=model))
    while target := session.next_target():
        true_n = target.force_n * (1 + 0.05 * rng.uniform(-1, 1))
        place = target.location_mm + errors_mm[target.location_mm]
        new = press(true_n, place, model=model, frequency_hz=frequency)
        typed_n = round(true_n * 1.01 + 0.03 * rng.standard_normal(), 2)
        session.check_force(typed_n, target.force_n)
        session.add(replace(new, location_mm=target.location_mm, force_n=typed_n))
    assert session.doubts() == []


def test_press_that_slipped_further_than_a_short_moves_is_refused(session):
    """The rest of the sweep would be measured somewhere else, and the table refused at the end."""
    for force_n in PLAN.force_n[:4]:
        session.add(press(force_n, 40.0))
    slipped = replace(press(3.0, 60.0), location_mm=40.0)
    with pytest.raises(InputError, match="phases: must not jump at port 1 against"):
        session.add(slipped)
    session.add(press(3.0, 40.0))
    assert len(session.presses) == 5


@pytest.mark.parametrize(
    ("force_n", "rule"),
    [
        (0.4, "0.5 to 10 N"),
        (10.1, "0.5 to 10 N"),
        (-2.0, "0.5 to 10 N; a gauge that shows less than nothing is inverted"),
        (204.0, r"0.5 to 10 N \(is it in g\? 204 g are 2 N\)"),
        (6.2, "about 1 N, as asked for, got 6.2"),
    ],
)
def test_force_that_cannot_be_is_refused(session, force_n, rule):
    """One slip of the finger would spoil the sensor."""
    session.check_force(1.4, 1.0)
    with pytest.raises(InputError, match=f"force_n: must be {rule}"):
        session.check_force(force_n, 1.0)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"location_mm": (20.0, 20.0)}, "location_mm: must be two or more different"),
        ({"location_mm": (20.0, 90.0)}, "location_mm: must lie within the line, 0 to 80 mm"),
        ({"force_n": (1.0, 2.0, 2.0, 3.0, 4.0)}, "force_n: must be at least 5 forces, rising"),
        ({"force_n": (-1.0, 2.0, 3.0, 4.0, 5.0)}, "force_n: must lie within 0 to"),
    ],
)
def test_plan_that_gives_no_sensor_is_refused(change, rule):
    with pytest.raises(InputError, match=rule):
        SessionPlan("arm", 900e6, **change)


LARGEST_DEG = steady_deg(900e6)


@pytest.fixture
def sensor():
    held = HandHeldSensor()
    held.force_n = 3.0
    return held


def test_press_that_holds_still_gives_mean_phases_and_their_error(sensor):
    press = measure_press(sensor.readings(), 40.0, 3.0, LARGEST_DEG)
    error = np.array(press.phase_deg) - sensor.model.phases_deg(3.0, 40.0)
    assert np.all(np.abs(error) < 4 * np.array(press.phase_std_deg))
    assert press.phase_std_deg == pytest.approx((0.1 / 14**0.5,) * 2, rel=0.6)
    assert press.groups == 14 and not press.untouched


def test_press_near_the_wrap_of_the_angle_keeps_its_mean(sensor):
    readings = [
        replace(each, phase1_deg=(179.9, -179.9)[i % 2]) for i, each in enumerate(sensor.readings())
    ]
    press = measure_press(readings, 40.0, 3.0, LARGEST_DEG)
    assert abs(abs(press.phase_deg[0]) - 180) < 0.01


def test_steady_presses_with_more_noise_are_not_refused_unless_they_scatter():
    """A user with a weak tag could not calibrate."""
    weak, noisy = (HandHeldSensor(noise_deg=noise_deg) for noise_deg in (1.0, 8.0))
    weak.force_n = noisy.force_n = 3.0
    for _ in range(200):
        measure_press(weak.readings(), 40.0, 3.0, LARGEST_DEG)
    with pytest.raises(InputError, match="must be received better"):
        measure_press(noisy.readings(), 40.0, 3.0, LARGEST_DEG)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda r: [*r[:-1], replace(r[-1], phase1_deg=r[-1].phase1_deg + 3)], "1 changed by 3"),
        (
            lambda r: [replace(x, phase2_deg=x.phase2_deg - 0.15 * i) for i, x in enumerate(r)],
            "port 2 changed by 1",
        ),
        (
            lambda r: [*r[:-3], *(replace(x, touch=0) for x in r[-3:])],
            "must be touched; no touch in 3 of 14 readings",
        ),
        (
            lambda r: [*r[:4], replace(r[4], touch=None, phase1_deg=None), *r[5:]],
            "the tag was not in 1 of 14 readings",
        ),
        (lambda r: r[5:10], "must have at least 8 readings, got 5"),
        (lambda r: [*r[:7], replace(r[7], flags=("moved",)), *r[8:]], "the tag or an antenna mov"),
    ],
)
def test_press_that_is_not_measured_well_is_refused(sensor, change, rule):
    with pytest.raises(InputError, match=rule):
        measure_press(change(sensor.readings()), 40.0, 3.0, LARGEST_DEG)


@pytest.mark.parametrize("flag", sorted(RECEPTION.words))
def test_press_in_a_group_that_was_received_badly_is_refused(sensor, flag):
    """A flag that is new would otherwise let what it warns of into a sensor file."""
    readings = sensor.readings()
    readings[7] = replace(readings[7], flags=(flag,))
    with pytest.raises(InputError, match=f"flagged; '{flag}' in 1 of 14"):
        measure_press(readings, 40.0, 3.0, LARGEST_DEG)


@pytest.mark.parametrize("flag", sorted(EXPLANATION.words))
def test_press_with_a_flag_of_the_provisional_model_is_measured(sensor, flag):
    """The model is what the calibration replaces: its opinion must not prevent that."""
    sensor.flags = (flag,)
    assert measure_press(sensor.readings(), 40.0, 3.0, LARGEST_DEG).groups == 14


def test_untouched_sensor_that_is_touched_or_disturbed_is_refused(sensor):
    with pytest.raises(InputError, match="must be released; a touch in 14 of 14"):
        measure_untouched(sensor.readings(), LARGEST_DEG)
    sensor.force_n, sensor.flags = 0.0, ("inconsistent",)
    with pytest.raises(InputError, match="reference was disturbed"):
        measure_untouched(sensor.readings(), LARGEST_DEG)
