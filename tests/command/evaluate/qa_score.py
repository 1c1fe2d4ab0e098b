# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings against a force gauge: alignment in time, errors, and files that gauges write."""

import csv
import json

import numpy as np
import pytest
from command_runs import refused, rows_of, run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.calibration.gauge_comparison import (
    TimedForces,
    compare_with_gauge,
    timed_forces,
)
from gnuradio.wiforce.calibration.gauges import GaugeRecord, read_gauge
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.mcap_file import McapWriter
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import Reading

PERIOD_S, STD_N, OFFSET_S = 0.036, 0.1, 1234.567
# Starts and ends of presses, which do not repeat regularly, and their forces.
PRESSES = [(5.0, 7.0, 3.0), (9.5, 10.2, 2.0), (14.0, 17.0, 5.0), (19.0, 19.9, 1.5)]


def force_at(time_s, presses=PRESSES):
    """The force of all presses: trapezoids that rise and fall in 0.2 s."""
    total = np.zeros_like(time_s)
    for start, end, force in presses:
        total += force * np.clip(np.minimum(time_s - start, end - time_s) / 0.2, 0, 1)
    return total


def readings(seed=1, gain=1.0):
    """Readings with noise; the sensor feels nothing below 0.3 N."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.018, 25, PERIOD_S)
    fine = times[:, None] + np.linspace(-0.5, 0.5, 21) * PERIOD_S
    mean = force_at(fine).mean(axis=1)
    touched = mean > 0.3
    forces = np.where(touched, gain * mean + STD_N * rng.standard_normal(len(times)), 0.0)
    return TimedForces(times, forces, np.full(len(times), STD_N), touched, times > 0.5)


def gauge(sign=1, zero=0.0, offset_s=OFFSET_S):
    rng = np.random.default_rng(2)
    times = np.arange(-4, 30, 0.0071)
    forces = sign * force_at(times) + zero + 0.01 * rng.standard_normal(len(times))
    return GaugeRecord(times + offset_s, forces)


# Most loggers write seconds since 1970.
@pytest.mark.parametrize(
    ("sign", "zero", "offset_s"), [(1, 0.0, OFFSET_S), (-1, 0.4, OFFSET_S), (1, 0.0, 1.7e9)]
)
def test_offset_sign_and_zero_of_a_gauge_are_found(sign, zero, offset_s):
    found = compare_with_gauge(readings(), gauge(sign, zero, offset_s))
    # The slopes of 8 edges of 10 to 25 N/s hold some 60 readings of 0.1 N: 1 to 2 ms.
    assert found.offset_s == pytest.approx(offset_s, abs=4e-3)
    assert abs(found.offset_s - offset_s) < 4 * found.offset_std_s < 0.02
    assert found.sign == sign and found.zero_n == pytest.approx(zero, abs=0.005)
    assert found.other_offset_s is None and abs(found.correlation) > 0.99


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("press", "end_s"), [((0.44, 3.79), 4.3), ((2.25, 5.17), 5.3)])
def test_sign_of_a_gauge_is_found_in_one_press(press, end_s, sign):
    """Its end in half of the record was taken for its begin, inverted: 3 s off."""
    rng = np.random.default_rng(4)
    times, fine = np.arange(0.018, end_s, PERIOD_S), np.arange(-1.0, end_s + 1.0, 0.01)
    force, expected = (force_at(at, [(*press, 4.0)]) for at in (times, fine))
    noise = STD_N * rng.standard_normal(len(times))
    touched = force > 0.3
    own = TimedForces(
        times, np.where(touched, force + noise, 0.0), np.full(len(times), STD_N), touched, times > 0
    )
    shown = GaugeRecord(fine + OFFSET_S, sign * expected)
    found = compare_with_gauge(own, shown)
    assert found.offset_s == pytest.approx(OFFSET_S, abs=0.03)
    assert found.sign == sign and found.other_offset_s is None


def test_errors_are_those_of_the_readings():
    found = compare_with_gauge(readings(), gauge())
    count = len(found.error_n)
    # Pressed groups between pressed ones; noise of the gauge may move the edge of one press.
    times = readings().time_s[:, None] + np.linspace(-0.5, 0.5, 21) * PERIOD_S
    pressed = force_at(times).mean(axis=1) >= 0.5
    assert abs(count - np.sum(pressed[:-2] & pressed[1:-1] & pressed[2:])) <= 1
    assert np.sqrt(np.mean(found.error_n**2)) == pytest.approx(STD_N, rel=4 / np.sqrt(2 * count))
    assert np.mean(found.error_n) == pytest.approx(0, abs=4 * STD_N / np.sqrt(count))
    assert found.coverage == pytest.approx(0.954, abs=4 * 0.21 / np.sqrt(count))
    assert (found.flagged, found.missed, found.false) == (0, 0, 0)


@pytest.mark.parametrize("rows_without_force", [False, True])
def test_holes_of_the_gauge_are_left_out(tmp_path, rows_without_force):
    """A line drawn through a lost edge of a press was compared as if the gauge had recorded it."""
    times = np.arange(0, 28, 0.025)
    lost = (times > 5.5) & (times < 8.0) | (np.abs(times - 15) < 0.01)
    forces = ["" if hole else f"{force_at(t):.4f}" for t, hole in zip(times, lost, strict=True)]
    rows = [f"{t:.4f},{force}" for t, force in zip(times, forces, strict=True)]
    if not rows_without_force:
        rows = [row for row in rows if not row.endswith(",")]
    (tmp_path / "cell.csv").write_text("\n".join(["time_s,force_n", *rows]))
    own = readings()
    found = compare_with_gauge(own, read_gauge(tmp_path / "cell.csv"))
    assert np.sqrt(np.mean(found.error_n**2)) < 1.15 * STD_N
    inside = (found.time_s > 5.52) & (found.time_s < 7.96) | (np.abs(found.time_s - 15) < 0.025)
    assert not inside.any() and abs(found.offset_s) < 0.01
    assert found.unrecorded == pytest.approx((8.0 - 5.5 + 0.05) / PERIOD_S, abs=5)


def test_flagged_missed_and_false_touches_are_counted_and_not_compared():
    own = readings()
    press = (own.time_s > 14.5) & (own.time_s < 16.5)
    idle = (own.time_s > 11.5) & (own.time_s < 12.5)
    clear, touched, force = own.clear.copy(), own.touched.copy(), own.force_n.copy()
    clear[np.flatnonzero(press)[:5]] = False
    touched[np.flatnonzero(press)[5:9]], force[np.flatnonzero(press)[5:9]] = False, 0.0
    touched[np.flatnonzero(idle)[:3]], force[np.flatnonzero(idle)[:3]] = True, 2.0
    found = compare_with_gauge(
        TimedForces(own.time_s, force, own.force_std_n, touched, clear), gauge()
    )
    assert (found.flagged, found.missed, found.false) == (5, 4, 3)
    assert len(found.error_n) == len(compare_with_gauge(own, gauge()).error_n) - 9


@pytest.mark.parametrize("forces_n", [(3,) * 10, (3, 5, 2, 6, 3, 5, 4, 2, 6, 3)])
def test_presses_that_repeat_are_ambiguous_unless_their_forces_differ(forces_n):
    def force(time_s):
        press = (time_s // 4 % 10).astype(int)
        return np.array(forces_n, float)[press] * ((time_s % 4 > 1) & (time_s % 4 < 2))

    times, fine = np.arange(0, 40, PERIOD_S), np.arange(-5, 45, 0.01)
    own = force(times)
    regular = TimedForces(times, own, 0 * times + 0.1, own > 0, times >= 0)
    found = compare_with_gauge(regular, GaugeRecord(fine, force(fine)))
    if len(set(forces_n)) > 1:
        assert found.other_offset_s is None and found.offset_s == pytest.approx(0, abs=0.01)
    else:
        periods = (found.other_offset_s - found.offset_s) / 4
        assert periods == pytest.approx(round(periods), abs=0.01)
    given = compare_with_gauge(regular, GaugeRecord(fine, force(fine)), offset_s=0.0)
    assert given.offset_s == 0 and given.offset_std_s == 0


@pytest.mark.parametrize(
    ("time_s", "force_n", "rule"),
    [
        # of another experiment
        (
            np.arange(0, 60, 0.01),
            np.random.default_rng(3).standard_normal(6000),
            "must agree with the readings: the correlation is",
        ),
        ([0.0, 1e9], [0.0, 5.0], "must span at most 360000 s"),
        ([0.0, 9e4, 2e5], [0.0, 2.0, 1.0], "must hold several values while the readings last"),
        # It ends before a press begins.
        ([0.0, 0.04, 0.08, 0.12], [0.0, 0.0, 0.0, 0.0], "must agree with the readings"),
        # Few slow values can resemble a press by chance.
        ([0.0, 8.0, 16.0, 24.0], [2.0, 3.0, 5.0, 1.0], "must agree with the readings"),
    ],
)
def test_gauge_that_cannot_show_these_presses_is_refused(time_s, force_n, rule):
    """Figures by chance are worthless."""
    with pytest.raises(InputError, match=f"gauge: {rule}"):
        compare_with_gauge(readings(), GaugeRecord(np.array(time_s), np.array(force_n)))


FILES = {
    "time_s,force_n\n0,1\n0.5,2\n": ([0, 0.5], [1, 2]),
    "Time (ms);Load [kgf]\n0;0,5\n250;1,5\n": ([0, 0.25], [0.5 * 9.80665, 1.5 * 9.80665]),
    "Timestamp\tChannel\tFz (mN)\n1\ta\t1000\n2\ta\t2000\n": ([1, 2], [1, 2]),
    "time,force\n2026-01-01T00:00:00Z,1\n2026-01-01T00:00:01.5Z,3\n": ([0, 1.5], [1, 3]),
    "t,force,comment\n0,1,\n0,2,\n1,3,released\n2,,\n": ([0, 1], [2, 3]),
    # Loggers write rows that end in a separator, whose times were taken for forces.
    "Time (h);Force (N)\n0;5;\n1;7;\n": ([0, 3600], [5, 7]),
}


@pytest.mark.parametrize("text", FILES)
def test_files_of_gauges_are_understood(text, tmp_path):
    (tmp_path / "cell.csv").write_text(text)
    record = read_gauge(tmp_path / "cell.csv")
    times, forces = FILES[text]
    assert record.time_s.tolist() == pytest.approx(times)
    assert record.force_n.tolist() == pytest.approx(forces)


BAD = {
    "time_s,force_n\nnan,1\n1,2\n2,3\n": "time_s must be given where there is a force",
    "a,b\n0,1\n1,1\n": "no column sounds like a time (a, b); state it with --time-column",
    "time,force,load\n0,1,1\n1,1,1\n": "several columns sound like a force (force, load)",
    "time,force (psi)\n0,1\n1,1\n": "names an unknown unit of force; state it with --unit",
    "force\n0\n": "must have columns of times and forces",
    "": "is not a CSV file",
    "time_s,force_n\n": "must hold two forces or more",
    "time_s,force_n\n1,0\n1,2\n": "time_s must increase",
    "time_s,force_n\n0,0\n1,1e308\n2,-1e308\n": "row 3: force_n must be below 1e+12 N",
    "Time (days),Force\n0,0\n1,2\n": "Time (days): names an unknown unit of time",
    "time_s,force_n\n0,True\n1,False\n": "row 2: force_n must be a finite number",
    "time_s,force_n\n0,5,1,2\n1,5,2,2\n": "must not have more fields than there are columns",
    "t,force\n0,1\n1,\n2,1\n1,2\n": "row 5: t must not decrease",
}


@pytest.mark.parametrize("text", BAD)
def test_files_that_are_no_gauges_are_refused(text, tmp_path):
    (tmp_path / "cell.csv").write_text(text)
    with pytest.raises(InputError) as refused:
        read_gauge(tmp_path / "cell.csv")
    assert BAD[text] in str(refused.value)


def rows_from(sensor, own, share=1.0, idle_until_s=0.0):
    """A sensor's readings as rows, with a share of the forces, untouched until a time."""
    for time_s, force, touched, clear in zip(
        own.time_s, own.force_n, own.touched, own.clear, strict=True
    ):
        pressed = touched and time_s >= idle_until_s
        yield {
            "time_s": time_s,
            "sensor": sensor,
            "touch": int(pressed),
            "force_n": share * force if pressed else None,
            "force_std_n": STD_N if pressed else None,
            "flags": "" if clear else "reference",
        }


def test_the_sum_of_sensors_is_compared_with_the_gauge_that_bears_them():
    """Two sensors under one plate have one load cell; each alone would read half of it."""
    left, right = (list(rows_from(name, readings(), 0.5)) for name in ("left", "right"))
    summed = timed_forces([*left, *right], ("left", "right"))
    found = compare_with_gauge(summed, gauge())
    alone = compare_with_gauge(timed_forces([*left, *right], "left"), gauge())
    assert found.gain == pytest.approx(1.0, abs=0.01) == 2 * alone.gain
    # Errors of two sensors are independent: sqrt(2) of one standard deviation.
    np.testing.assert_allclose(summed.force_std_n[summed.touched], np.sqrt(2) * STD_N)
    # Where one of them is untouched, the other's force and standard deviation are the sum's.
    late = timed_forces([*left, *rows_from("right", readings(), 0.5, 30.0)], ("left", "right"))
    np.testing.assert_allclose(late.force_std_n[late.touched], STD_N)
    np.testing.assert_allclose(late.force_n, summed.force_n / 2)


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        (None, "sensor: must be one of left, right, or several to be added"),
        (("left", "leg"), "sensor: must be one of left, right, got 'leg'"),
        (("left", "left"), "sensor: must not be named twice, got 'left'"),
        (("left", "right"), "readings: must have the sensors that are added at the same times"),
    ],
)
def test_sensors_that_cannot_be_added_are_refused(sensors, message):
    rows = [*rows_from("left", readings()), *list(rows_from("right", readings()))[1:]]
    with pytest.raises(InputError) as refused:
        timed_forces(rows, sensors)
    assert str(refused.value) == message


def write(writer, own):
    for row in zip(own.time_s, own.force_n, own.touched, own.clear, strict=True):
        time_s, force, touched, clear = row
        values = (float(force), STD_N) if touched else (None, None)
        flags = () if clear else ("reference",)
        writer.write(Reading(float(time_s), "arm", int(touched), *values, flags=flags))


def write_gauge(path, cell):
    with open(path, "w") as stream:
        rows = csv.writer(stream)
        rows.writerow(["time_s", "force_n"])
        rows.writerows(zip(cell.time_s, cell.force_n.round(4), strict=True))


@pytest.fixture
def arguments(tmp_path):
    """Those that score a file of readings against one of a gauge that is inverted."""
    with open_writer(tmp_path / "r.csv") as writer:
        write(writer, readings())
    write_gauge(tmp_path / "cell.csv", gauge(-1, 0.2))
    return ["score", tmp_path / "r.csv", "--against", tmp_path / "cell.csv"]


def test_score_compares_a_file_of_readings(tmp_path, arguments):
    """A user wants figures and a picture, from readings that were made long ago."""
    done = succeeded(*arguments, "--json", "--plot", tmp_path / "p.png", "-o", tmp_path / "o.csv")
    report = json.loads(done.stdout)
    assert report["offset_s"] == pytest.approx(OFFSET_S, abs=4e-3)
    assert (report["gauge_sign"], report["gauge_zero_n"]) == (-1, pytest.approx(0.2, abs=0.005))
    assert (tmp_path / "p.png").stat().st_size > 10_000
    errors = [float(row["error_n"]) for row in rows_of(tmp_path / "o.csv")]
    assert len(errors) == report["compared"]
    assert np.median(np.abs(errors)) == pytest.approx(report["median_error_n"], abs=1e-4)
    assert "gauge_sign      -1\n" in run_command(*arguments).stdout
    for more, message in {
        ("--sensor", "leg"): "--sensor: must be one of arm, got 'leg'",
        ("--force-column", "x"): "--force-column: must be one of the columns of",
        ("--scene", "demo"): "a file of readings needs none",
        ("--unit", "mm"): "--unit: must be one of N, mN, kN, g, kg, lb, oz, got 'mm'",
    }.items():
        assert message in refused(*arguments, *more)


@pytest.mark.parametrize(
    ("header", "unit", "warned"),
    [
        ("Load [g]", "kN", "Load [g] names the unit g, and is read in kN, which --unit states"),
        ("Load [kgf]", "kg", None),
        ("Load", "kN", None),
        ("force_raw", "lb", None),
    ],
)
def test_score_warns_where_the_unit_is_not_that_of_the_header(arguments, header, unit, warned):
    """The gain was 0.0, and nothing said why."""
    cell = arguments[-1]
    cell.write_text(cell.read_text().replace("force_n", header))
    done = succeeded(*arguments, "--unit", unit)
    assert (f"{cell}: {warned}\n" in done.stderr) if warned else done.stderr == ""


def test_score_says_where_a_file_of_readings_is_cut_off(tmp_path, arguments):
    """Presses that the file lost were scored as if there had been none."""
    path, cell = tmp_path / "r.mcap", arguments[-1]
    with McapWriter(path) as writer:
        write(writer, readings())
    path.write_bytes(path.read_bytes()[:-100])
    done = succeeded("score", path, "--against", cell)
    assert f"{path}: ends behind reading " in done.stderr
    with pytest.warns(UserWarning, match="ends behind reading"):
        wiforce.score(path, cell)
