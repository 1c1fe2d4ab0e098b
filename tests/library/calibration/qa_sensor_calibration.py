# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration: any honest table becomes a model, what a table cannot support is refused or said."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce import sensor
from gnuradio.wiforce.calibration.calibrate import calibrate, refine
from gnuradio.wiforce.calibration.data import sweep_directions
from gnuradio.wiforce.calibration.fit import CurveFitter
from gnuradio.wiforce.calibration.tables import (
    CalibrationTable,
    measure_vna,
    read_tap_csv,
    read_touchstone_index,
    read_vna_csv,
    table_kind,
)
from gnuradio.wiforce.calibration.validation import calibration_warnings
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene.effects import Beam
from gnuradio.wiforce.scene.simulated import Press
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.curves import force_knots
from gnuradio.wiforce.simulation.presses import press_force, shown_force
from sensor_laws import LAWS, read_law, untouched_deg, vna_rows, wrap

FORCES = np.linspace(2, 8, 25)
LIMITS = {900e6: (0.12, 0.2), 2400e6: (0.08, 0.12)}


def written(path, rows):
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture
def rows():
    """A clean table of an own law, as text."""
    return vna_rows(LAWS[0], 900e6, FORCES, 0.1, np.random.default_rng(4))


@pytest.fixture
def own_table(rows, tmp_path):
    return lambda: read_vna_csv(written(tmp_path / "vna.csv", rows))


@pytest.mark.parametrize("law, frequency", zip(LAWS, (900e6, 2400e6, 900e6), strict=True))
def test_laws_it_never_saw_are_read_between_calibrated_locations(tmp_path, law, frequency):
    rng = np.random.default_rng(11)
    rows = vna_rows(law, frequency, np.linspace(2, 8, 30), 0.2, rng)
    model = calibrate(read_vna_csv(written(tmp_path / "vna.csv", rows)), "own")
    result = read_law(model, law, frequency, 400, rng)
    force, location = LIMITS[frequency]
    assert np.median(result.force_error, axis=1).max() <= force
    assert np.median(result.location_error, axis=1).max() <= location
    # One calibration of twelve: each has errors of its own. All: tests/models/sensor_acceptance.py
    assert 0.88 <= result.coverage("force")
    assert 0.80 <= result.coverage("location")


def test_curves_through_six_forces_still_know_the_noise_of_their_table():
    """Where smoothing is nearly off, residuals are far below the noise that they come from."""
    noise_deg, forces = 0.015, np.array([1.0, 2.0, 3.0, 4.0, 6.0, 8.0])
    true = load_sensor("line-900mhz")
    at = [axis.ravel() for axis in np.meshgrid(np.arange(1.5, 8), np.arange(22.0, 60, 6))]
    inside = []
    for seed in range(2):
        table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], forces, noise_deg, seed)
        model = calibrate(table, "arm")
        assert "suspicions" not in model.provenance
        # 10 curves of six rows: their mean square is known to a third
        assert all(0.5 * noise_deg < noise < 2 * noise_deg for noise in model.noise_deg())
        read = model.invert(true.phases_deg(*at), 0.02)
        inside.append(np.abs(read.force_n - at[0]) < 2 * read.force_std_n)
    assert np.mean(inside) > 0.95


def test_a_wrong_row_beside_few_others_makes_no_noise_of_its_own():
    """Coefficients that the constraint holds leave residuals that are no noise of the others."""
    forces = np.array([1.0, 1.1, 1.2, 4.0, 6.0, 8.0])
    true = load_sensor("line-900mhz")
    table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], forces, 0.015)
    phases = table.phase_deg.copy()
    wrong = (table.location_mm == 40) & (table.force_n == 4) & (table.port == 1)
    phases[wrong] += 10.0
    model = calibrate(replace(table, phase_deg=phases), "arm")
    assert max(model.noise_deg()) < 10.0
    (text,) = model.provenance["suspicions"]
    assert text.startswith("the phase of 4 N at location 40 mm, port 1, is +10.0 deg beside")


def test_untouched_rows_give_the_untouched_phases(own_table, rows):
    model = calibrate(own_table(), "own")
    assert model.untouched_deg() == pytest.approx([wrap(untouched_deg(900e6))] * 2, abs=0.5)
    assert not any("untouched" in text for text in model.provenance["assumed"])
    del rows[1:3]
    model = calibrate(own_table(), "own")
    assert model.untouched_deg() == pytest.approx([wrap(untouched_deg(900e6))] * 2, abs=1e-6)
    assert any("untouched phases" in text for text in model.provenance["assumed"])


def test_phases_count_modulo_360_and_rows_in_any_order(own_table, rows):
    table, rng = own_table(), np.random.default_rng(1)
    turned = table.phase_deg + 360 * rng.integers(-2, 3, len(rows) - 1)
    other = replace(table, phase_deg=turned).take(rng.permutation(len(turned)))
    presses = FORCES[:, None], np.linspace(20, 60, 9)
    phases, reference = (calibrate(each, "own").phases_deg(*presses) for each in (other, table))
    assert np.abs(wrap(phases - reference)).max() < 1e-3


def test_ports_may_have_forces_of_their_own(own_table, rows):
    reference = calibrate(own_table(), "own")
    rows[:] = [row for i, row in enumerate(rows) if i < 3 or "0,2," not in row or i % 3]
    model = calibrate(own_table(), "own")
    difference = model.phases_deg(5.0, [25.0, 40.0]) - reference.phases_deg(5.0, [25.0, 40.0])
    assert np.abs(difference).max() < 0.4


def test_sweeps_that_start_before_the_contact_give_the_onset():
    line = load_sensor("line-900mhz")
    table = measure_vna(line, (20, 40, 60), np.arange(0.2, 8.1, 0.2), 0.1, seed=1)
    model = calibrate(table, "own")
    assert model.onset_force_n == pytest.approx(0.9, abs=0.11)
    assert model.force_span_n[0] == pytest.approx(1.0, abs=0.21)


def test_several_carriers_go_into_one_model(tmp_path):
    rng = np.random.default_rng(2)
    low = vna_rows(LAWS[1], 900e6, FORCES, 0.2, rng)
    high = vna_rows(LAWS[1], 2400e6, FORCES, 0.2, rng)
    model = calibrate(read_vna_csv(written(tmp_path / "v.csv", low + high[1:])), "own")
    assert model.frequencies_hz == (900e6, 2400e6)
    for frequency in model.frequencies_hz:
        phases = LAWS[1].phases_deg(5.0, 33.0, frequency)
        assert np.abs(wrap(model.phases_deg(5.0, 33.0, frequency) - phases)).max() < 0.6
    with pytest.raises(InputError, match="holds several carriers"):
        model.phases_deg(5.0, 33.0)


def of_one_port_above(row):
    """Whether a row is kept where the ports at 40 mm have no force in common."""
    _, place, port, force, _ = row.split(",")
    return place != "40" or (float(force) < 4.5) == (port == "1")


@pytest.mark.parametrize(
    "keep, message",
    [
        (lambda row: ",40," in row, "row 2: location_mm: must have at least two locations at 900"),
        (of_one_port_above, "must have forces that both ports share"),
        (lambda row: ",40,2," not in row, "must have at least 5 forces at port 2"),
    ],
)
def test_rows_that_determine_no_model_are_refused(own_table, rows, keep, message):
    rows[1:] = filter(keep, rows[1:])
    with pytest.raises(InputError, match=message):
        calibrate(own_table(), "own")


@pytest.mark.parametrize(
    "row, message",
    [
        ("900.000,30,1,x,12", "row 254: force_n: must be a number, got 'x'"),
        ("900.000,30,1,3,nan", "row 254: phase_deg: must be finite"),
        ("900.000,30,3,3,12", "row 254: port: must be 1 or 2, got '3'"),
        ("900.000,,1,3,12", "row 254: location_mm: must be given"),
        ("900.000,30,1,-3,12", "row 254: force_n: must be at least"),
        ("900.000,95,1,3,12", "row 254: location_mm: must lie within the line"),
        ("-5,30,1,3,12", "row 254: freq_mhz: must be 1 to"),
    ],
)
def test_rows_that_cannot_be_are_refused_by_number(own_table, rows, row, message):
    rows.append(row)
    with pytest.raises(InputError, match=message):
        calibrate(own_table(), "own")


def test_a_jump_that_is_neither_a_turn_nor_in_the_force_is_refused(own_table, rows):
    *start, phase = rows[70].split(",")
    rows[70] = ",".join([*start, f"{float(phase) + 100:.4f}"])
    with pytest.raises(InputError, match="row 71: phase_deg: must not jump by"):
        calibrate(own_table(), "own")


def test_repeated_sweeps_with_equal_rounded_phases_are_repeats(own_table, rows):
    """Phases are rounded: whoever measures carefully, and again, gets equal ones."""
    once = calibrate(own_table(), "own").carrier_std_deg(FORCES, 40.0, 0)
    for seed in (5, 6):
        rows += vna_rows(LAWS[0], 900e6, FORCES, 0.1, np.random.default_rng(seed))[1:]
    table = own_table()
    repeated = calibrate(replace(table, phase_deg=table.phase_deg.round(1)), "own")
    assert np.mean(repeated.carrier_std_deg(FORCES, 40.0, 0)) < 0.8 * once.mean()


def test_a_path_in_place_of_the_table_is_refused():
    """It ended in an AttributeError of the inside."""
    rule = "table: must be a CalibrationTable, such as sensor.read_vna_csv gives, got 'vna.csv'"
    with pytest.raises(InputError, match=rule):
        calibrate("vna.csv", "x")


def test_settings_that_cannot_be_are_refused(own_table):
    for setting, value in (
        ("form", "septic"),
        ("length_mm", 1e300),
        ("permittivity", 0.5),
        ("onset_force_n", 9.0),
        ("ruler_std_mm", 81.0),
        ("location_steps", "sideways"),
    ):
        with pytest.raises(InputError, match=setting):
            calibrate(own_table(), "own", **{setting: value})


def test_calibration_warnings_name_what_is_not_supported(own_table, rows):
    assert calibration_warnings(calibrate(own_table(), "own")) == []
    rows[:] = [row for row in rows if ",30," not in row and ",50," not in row]
    few = calibration_warnings(calibrate(own_table(), "own"))
    assert any("3 locations: a kink" in text for text in few)
    paper = " ".join(calibration_warnings(load_sensor("paper-900mhz")))
    for warning in ("do not fit a line", "location 40 mm"):
        assert warning in paper


@pytest.mark.parametrize("joined", [True, False])
def test_touchstone_gives_the_phases_at_the_carrier(tmp_path, joined):
    import skrf

    law, frequency = LAWS[0], skrf.Frequency(700, 1100, 81, unit="MHz")
    index = ["file,force_n,location_mm"]
    presses = [(0.0, None), (2.0, 20.0), (8.0, 60.0)]
    for number, (force, place) in enumerate(presses):
        angle = [
            law.phases_deg(force, place, f) if force else np.full(2, untouched_deg(f))
            for f in frequency.f
        ]
        s = np.zeros((81, 2, 2), complex)
        if force or joined:
            s[:, [0, 1], [0, 1]] = 0.97 * np.exp(1j * np.radians(angle))
        else:  # a matched line, whose ends are 50 ohm in a sweep of both ports
            s[:, [0, 1], [1, 0]] = 0.97 * np.exp(1j * np.radians(angle) / 2)
        network = skrf.Network(frequency=frequency, s=s)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            network.write_touchstone(f"p{number}", dir=str(tmp_path))
        index.append(f"p{number}.s2p,{force:g},{'' if place is None else place}")
    path = written(tmp_path / "index.csv", index)
    assert table_kind(path) == "touchstone"
    table = read_touchstone_index(path, 900e6)
    expected = [[untouched_deg(900e6)] * 2, *(law.phases_deg(*each, 900e6) for each in presses[1:])]
    assert np.abs(wrap(table.phase_deg - np.concatenate(expected))).max() < 0.01
    with pytest.raises(InputError, match="p0.s2p must span the carrier 2400 MHz"):
        read_touchstone_index(path, 2.4e9)


@pytest.mark.parametrize(
    "name, rule",
    [
        ("p.s2p", "is not a Touchstone file"),
        ("absent.s2p", ".*absent.s2p: cannot be read"),
        ("/etc/passwd", "must lie in the index's folder"),
        ("a/../../x.s2p", "must lie in the index's folder"),
    ],
)
def test_an_index_neither_runs_code_nor_leads_out_of_its_folder(tmp_path, name, rule):
    ran = tmp_path / "ran"
    (tmp_path / "p.s2p").write_bytes(b"cos\nsystem\n(S'touch %s'\ntR." % bytes(ran))  # a pickle
    index = written(tmp_path / "index.csv", ["file,force_n,location_mm", f"{name},1,20"])
    with pytest.raises(InputError, match=f"row 2: file: {rule}"):
        read_touchstone_index(index, 900e6)
    assert not ran.exists()


def write_taps(path, law, offset_deg, noise_deg, rng):
    taps = []
    for number, place in enumerate(PLACES_MM):
        forces = np.sort(rng.uniform(2, 8, 15))
        phases = law.phases_deg(forces, place, 900e6) + offset_deg
        phases = wrap(phases + noise_deg * rng.standard_t(4, phases.shape))
        taps.append(np.column_stack([phases, forces, np.full(15, place), np.full(15, number)]))
    header = "phase1_deg,phase2_deg,force_n,location_mm,press"
    np.savetxt(path, np.concatenate(taps), "%.4f", ",", header=header, comments="")


def test_taps_bring_a_bench_model_to_what_the_air_shows(tmp_path, own_table):
    rng = np.random.default_rng(6)
    bench, offset = calibrate(own_table(), "own"), np.array([6.0, -4.0])
    path = tmp_path / "taps.csv"
    write_taps(path, LAWS[0], offset, 0.5, rng)
    assert table_kind(path) == "taps"
    refined = refine(bench, read_tap_csv(path, 900e6))
    forces, places = np.linspace(2.5, 7.5, 11)[:, None], np.array([25.0, 40.0, 55.0])
    truth = LAWS[0].phases_deg(forces, places, 900e6) + offset
    before = np.abs(wrap(bench.phases_deg(forces, places) - truth)).mean(axis=(0, 1))
    after = np.abs(wrap(refined.phases_deg(forces, places) - truth)).mean(axis=(0, 1))
    assert before == pytest.approx([6, 4], abs=0.2) and after.max() < 0.3
    # scatter of Student-t noise of scale 0.5 and four degrees of freedom
    assert 0.3 < min(refined.noise_deg()) and max(refined.noise_deg()) < 1.0
    assert "refined by taps" in refined.provenance["source"]
    # What a transfer between carriers leaves open is less than what taps may change.
    moved = replace(bench, transfer_std_deg=1.0, transferred_from_hz=915e6)
    assert refine(moved, read_tap_csv(path, 900e6)).transfer_std_deg is None


def test_taps_outside_the_model_are_refused(tmp_path, own_table):
    bench = calibrate(own_table(), "own")
    rows = ["phase1_deg,phase2_deg,force_n,location_mm", "1,2,3,70"]
    table = read_tap_csv(written(tmp_path / "t.csv", rows), 900e6)
    with pytest.raises(
        InputError, match="row 2: location_mm: must lie within the model's 20 to 60"
    ):
        refine(bench, table)
    with pytest.raises(InputError, match="must be at a carrier of the model"):
        refine(bench, read_tap_csv(tmp_path / "t.csv", 2.4e9))
    with pytest.raises(InputError, match="must have calibrated curves"):
        refine(load_sensor("line-900mhz"), table)


def test_the_spline_never_turns_back():
    rng = np.random.default_rng(8)
    force = np.sort(rng.uniform(2, 8, 40))
    value = 20 * np.tanh((force - 2) / 2) + rng.normal(0, 1.5, 40)
    fitter = CurveFitter("spline", force_knots("spline", force), [(force, value)])
    curve = fitter.fit(force, value).value(np.linspace(1, 10, 500))
    assert np.all(np.diff(curve) >= -1e-9)


def test_names_of_calibration_are_found_in_sensor():
    """Programs import them from ``gnuradio.wiforce.sensor``, wherever they are defined."""
    assert all(callable(getattr(sensor, name)) for name in sensor._MODULES)


TRUE = load_sensor("line-900mhz")
PLACES_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
NOISE_DEG = 0.2
TIMES_S = np.linspace(0.5, 19.5, 39)


def press(largest_n, place_mm):
    """A press that rises for ten seconds and falls for ten."""
    return Press(
        sensor="arm", start_s=0.0, rise_s=10.0, hold_s=0.0, force_n=largest_n,
        end_force_n=largest_n, location_mm=place_mm,
    )  # fmt: skip


def pressed_table(beam, times_s=TIMES_S):
    """What a VNA shows of presses up to 8 N at five locations, row by row in time."""
    rng = np.random.default_rng(3)
    untouched = measure_vna(TRUE, [40.0], [2.0], NOISE_DEG)
    rows = []
    for place in PLACES_MM:
        one = press(8.0, place)
        force, shown = press_force(one, times_s), shown_force(one, times_s, beam)
        phases = TRUE.phases_deg(shown, place)
        phases = phases + NOISE_DEG * rng.standard_normal(phases.shape)
        for port in (1, 2):
            for f, phase in zip(force, phases[:, port - 1], strict=True):
                rows.append((0, 900e6, place, port, f, phase, ""))
    touched = CalibrationTable.from_rows("bench", rows)
    return CalibrationTable.joined([untouched.take(untouched.untouched), touched])


@pytest.fixture(scope="module")
def soft():
    return calibrate(pressed_table(Beam(hysteresis=0.06, creep=0.0)), "soft")


def rigid(model):
    """The same calibration without what it knows of hysteresis."""
    return replace(model, carriers=tuple(replace(c, hysteresis_n=None) for c in model.carriers))


def within_two_std(model, beam):
    """Share of forces inside two standard deviations, loading and unloading, up to 6 N."""
    inside = []
    for place in (25.0, 36.0, 45.0, 54.0):
        one = press(6.0, place)
        force = press_force(one, TIMES_S)
        phases = TRUE.phases_deg(shown_force(one, TIMES_S, beam), place)
        found = model.invert(phases, NOISE_DEG)
        inside.append((np.abs(found.force_n - force) <= 2 * found.force_std_n)[force > 1.2])
    return np.mean(np.concatenate(inside))


@pytest.mark.parametrize(
    ("force_n", "expected"),
    [
        (np.r_[1:9, 7:0:-1], [1] * 8 + [-1] * 7),
        (np.r_[1:9, 1:9], [1] * 8 + [0] + [1] * 7),
        # the readings of a load cell while the force hardly changes
        ([1, 2, 4, 3.9, 4.1, 6, 8, 7.9, 8, 5, 3, 3.1, 1], [1] * 9 + [-1] * 4),
        (np.random.default_rng(1).permutation(np.linspace(1, 8, 30)), [0] * 30),
    ],
)
def test_sweep_directions_follow_from_the_order_of_rows(force_n, expected):
    assert sweep_directions(np.array(force_n, float)).tolist() == expected


def test_calibrate_both_branches_finds_half_the_largest_difference(soft):
    # 4 h F (P - F) / P has its largest value h P at half of P
    assert soft.carriers[0].hysteresis_n == pytest.approx(0.06 * 8 / 2, rel=0.15)


def test_readings_of_a_soft_beam_lie_inside_their_standard_deviations(soft):
    beam = Beam(hysteresis=0.06, creep=0.0)
    assert within_two_std(soft, beam) >= 0.95
    assert within_two_std(rigid(soft), beam) < 0.85


@pytest.mark.parametrize(("hysteresis", "rows", "expected"), [(0.06, 20, None), (0.0, 39, 0.0)])
def test_one_branch_says_nothing_of_hysteresis_and_an_elastic_beam_none(hysteresis, rows, expected):
    table = pressed_table(Beam(hysteresis=hysteresis, creep=0.0), TIMES_S[:rows])
    assert calibrate(table, "bench").carriers[0].hysteresis_n == expected
