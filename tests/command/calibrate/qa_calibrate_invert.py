# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce calibrate` and `invert` as a researcher runs them."""

import csv
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command_runs import refused, rows_of, succeeded
from gnuradio.wiforce.calibration.tables import measure_vna, read_vna_csv, write_vna_csv
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.sensor import load_sensor
from live_runs import SLOW


@pytest.fixture(scope="module")
def line():
    return load_sensor("line-900mhz")


@pytest.fixture(scope="module")
def folder(line, tmp_path_factory):
    """A VNA table of the line and the sensor made of it, with a report and a picture."""
    folder = tmp_path_factory.mktemp("calibration")
    table = measure_vna(line, (20, 30, 40, 50, 60), np.arange(1, 8.1, 0.5), 0.1, seed=2)
    write_vna_csv(table, folder / "vna.csv")
    done = succeeded(
        "calibrate", folder / "vna.csv", "-o", folder / "s.yaml", "--plot", folder / "s.png"
    )
    for stated in ("1..8 N, 20..60 mm", "noise of the phases 0.1", "cross-validation within"):
        assert stated in done.stdout
    assert (folder / "s.png").read_bytes().startswith(b"\x89PNG")
    return folder


@pytest.fixture
def inverted(folder, tmp_path):
    """What `invert` gives for rows of a table, by columns, and what it says."""

    def run(columns, rows, *options, sensor=folder / "s.yaml"):
        with open(tmp_path / "p.csv", "w", newline="") as stream:
            csv.writer(stream).writerows([columns, *rows])
        done = succeeded("invert", tmp_path / "p.csv", "--sensor", sensor, *options)
        return list(csv.DictReader(done.stdout.splitlines())), done.stderr

    return run


PHASES = "phase1_deg", "phase2_deg"


def test_phases_become_force_and_location_between_the_calibrated_ones(inverted, line):
    forces, places = np.array([2.5, 4.0, 6.5]), np.array([25.0, 45.0, 55.0])
    phases = line.phases_deg(forces, places)
    # As input an angle counts modulo 360; a known location is taken as known.
    rows = [
        (i, "arm", phases[i, 0] + 360 * i, phases[i, 1], places[i] if i else "") for i in range(3)
    ]
    rows.append((3, "arm", *line.untouched_deg(), ""))
    columns = "time_s", "sensor", *PHASES, "location_mm"
    readings, _ = inverted(columns, rows, "--std-deg", 0.1)
    for i in range(3):
        assert float(readings[i]["force_n"]) == pytest.approx(forces[i], abs=0.25)
        assert float(readings[i]["location_mm"]) == pytest.approx(places[i], abs=0.3)
        assert readings[i]["touch"] == "1" and readings[i]["sensor"] == "arm"
    assert float(readings[1]["location_std_mm"]) == 0
    assert readings[3]["touch"] == "0" and readings[3]["force_n"] == ""


def test_invert_with_large_std_does_not_report_untouched(inverted, line):
    """`--std-deg 45` reported presses as untouched, without a flag."""
    rows = [line.untouched_deg(), line.phases_deg(4.0, 40.0)]

    def found(*options):
        readings, _ = inverted(PHASES, rows, *options, sensor="line-900mhz")
        return [(row["touch"], row["flags"]) for row in readings]

    for std_deg in (45, 60):
        assert all(touch != "0" and "weak" in flags for touch, flags in found("--std-deg", std_deg))
    (untouched, first), (touched, second) = found("--std-deg", 4)
    assert (untouched, touched) == ("0", "1") and "weak" in first and "weak" in second
    assert found() == [("0", ""), ("1", "")]


def test_invert_warns_of_radians_and_of_phases_that_do_not_fit(inverted, line):
    phases = line.phases_deg([2.0, 3.0, 4.0, 5.0], [25.0, 35.0, 45.0, 55.0])
    for changed, message in (
        (phases, ""),
        (np.radians(phases), "in radians"),
        (-phases, "do not fit the sensor"),
        (2.7 * phases, "do not fit the sensor"),
    ):
        _, said = inverted(PHASES, changed.tolist(), sensor="line-900mhz")
        assert message in said and bool(message) == bool(said)


@pytest.mark.parametrize(
    "content, message",
    [
        ("", "has no rows"),
        ("phase1_deg,phase2_deg\n", "has no rows"),
        ("phase1_deg\n1\n", "phase2_deg (missing: phase2_deg)"),
        ("phase1_deg,phase1_deg\n1,2\n", "must have different names, got 'phase1_deg'"),
        # A decimal comma shifts all fields behind it.
        ("phase1_deg,phase2_deg\n1,2\n1,5,2\n", "row 3: must have as many fields as there are"),
        ("phase1_deg,phase2_deg\n1,2,\n", "row 2: must have as many fields as there are columns"),
        ("phase1_deg,phase2_deg\n1,x\n", "row 2: phase2_deg: must be a number, got 'x'"),
        ("phase1_deg,phase2_deg\n1,nan\n", "row 2: phase2_deg: must be finite and at most 1e+12"),
        (
            "phase1_deg,phase2_deg\n-1e30,1\n",
            "phase1_deg: must be finite and at most 1e+12, got '-1e30'",
        ),
        ("phase1_deg,phase2_deg\n,20\n", "row 2: phase1_deg: must be a number, got ''"),
        ("time_s,phase1_deg,phase2_deg\n1,,\n", "must have a row with phases"),
        ("phase1_deg,phase2_deg,y_mm\n10,20,\n", "holds readings of a surface"),
    ],
)
def test_phases_that_cannot_be_are_refused_by_row(folder, tmp_path, content, message):
    (tmp_path / "p.csv").write_text(content)
    said = refused(
        "invert", tmp_path / "p.csv", "--sensor", folder / "s.yaml", "-o", tmp_path / "o.csv"
    )
    assert message in said and not (tmp_path / "o.csv").exists()


def test_readings_are_inverted_again_without_taking_their_location_as_known(
    inverted, tmp_path, line
):
    columns = "sensor", "touch", "force_n", "location_mm", "location_std_mm", *PHASES
    phases, given = line.phases_deg(4.0, 33.0), ((41.0, 0.5), (33.0, 0), (33.0, ""))
    outputs = "-o", tmp_path / "o.csv", "-o", tmp_path / "o.jsonl"
    inverted(columns, [("arm", 1, 3.0, *each, *phases) for each in given], *outputs)
    rows = rows_of(tmp_path / "o.csv")
    assert (tmp_path / "o.jsonl").read_text().count("\n") == len(rows) == 3
    assert float(rows[0]["location_mm"]) == pytest.approx(33.0, abs=0.5)
    assert float(rows[0]["location_std_mm"]) > 0
    assert [float(row["location_std_mm"]) for row in rows[1:]] == [0, 0]


@pytest.mark.parametrize("option", [[], ["--tracked"], ["--smoothed"]])
def test_readings_of_a_sensor_that_was_not_received_stay_empty_rows(inverted, line, option):
    """One lost group kept the output of `read` from being inverted again."""
    columns = "time_s", "sensor", "group", *PHASES, "flags"
    rows = [(t, "arm", t, *line.phases_deg(4.0, 33.0), "") for t in range(5)]
    lost = [(1, "arm", 1, "", "", "reference gap"), (2, "arm", 2, "", "", "")]
    found, _ = inverted(columns, [rows[0], *lost, *rows[3:]], *option)
    known = [{key: value for key, value in row.items() if value} for row in found[1:3]]
    assert known == [
        {"time_s": "1.0", "sensor": "arm", "flags": "gap", "group": "1"},
        {"time_s": "2.0", "sensor": "arm", "flags": "weak", "group": "2"},
    ]
    assert found[:1] + found[3:] == inverted(columns, [rows[0], *rows[3:]], *option)[0]


def test_taps_refine_a_sensor(folder, line, tmp_path):
    rows = [(*line.phases_deg(4.0, place), 4.0, place) for place in (25.0, 40.0, 55.0)]
    header = "phase1_deg,phase2_deg,force_n,location_mm"
    np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header=header, comments="")
    made, given = tmp_path / "refined.yaml", ("--refine", folder / "s.yaml")
    succeeded("calibrate", tmp_path / "t.csv", *given, "--frequency-hz", "900e6", "-o", made)
    assert (
        load_sensor(made)
        .provenance["source"]
        .endswith("refined by taps of " + str(tmp_path / "t.csv"))
    )


def test_a_table_of_any_name_is_calibrated(folder, tmp_path):
    """The sensor file was refused: its source must be printable text."""
    table = tmp_path / os.fsdecode(b"of\nMay \xe9.csv")
    table.write_bytes((folder / "vna.csv").read_bytes())
    succeeded("calibrate", table, "-o", tmp_path / "s.yaml")
    assert load_sensor(tmp_path / "s.yaml").provenance["source"].endswith("of May  .csv")


def test_write_vna_csv_needs_no_pandas_and_keeps_the_carrier(folder, tmp_path, monkeypatch):
    """`./bootstrap demo`, which writes such a table, installs no pandas."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    table = read_vna_csv(folder / "vna.csv")
    table = replace(table, frequency_hz=table.frequency_hz + 123456)
    write_vna_csv(table, tmp_path / "vna.csv")
    again = read_vna_csv(tmp_path / "vna.csv")
    assert again.frequency_hz == pytest.approx(table.frequency_hz, abs=1)
    assert (again.phase_deg == table.phase_deg).all() and (again.force_n == table.force_n).all()


def test_calibrate_from_a_pipe_needs_the_kind_and_reads_it_once(folder, tmp_path):
    """A table from a pipe had no rows when it was read again, and a named pipe hung."""
    os.mkfifo(tmp_path / "named")
    output = "-o", tmp_path / "o.yaml"
    said = refused("calibrate", tmp_path / "named", *output)
    assert said.endswith("named: must be a file, not a pipe or a device") and said.count(":") == 2
    content = (folder / "vna.csv").read_bytes()
    assert len(content) < 60_000  # what a pipe holds
    reading, writing = os.pipe()
    os.write(writing, content)
    os.close(writing)
    try:
        assert "must be a file, not a pipe" in refused("calibrate", f"/dev/fd/{reading}", *output)
        assert not (tmp_path / "o.yaml").exists()
        succeeded("calibrate", f"/dev/fd/{reading}", "--kind", "vna", *output)
    finally:
        os.close(reading)
    model, expected = load_sensor(tmp_path / "o.yaml"), load_sensor(folder / "s.yaml")
    assert model.phases_deg(4.0, 45.0) == pytest.approx(expected.phases_deg(4.0, 45.0), abs=1e-9)


OFF = [[0.2, -0.1], [-0.05, 0.15]]
PRESSES = [
    {"start_s": 0.4, "rise_s": 0.05, "hold_s": 0.3, "force_n": 2.0, "end_force_n": 6.0},
    {"start_s": 0.9, "rise_s": 0.05, "hold_s": 0.3, "force_n": 2.0, "end_force_n": 6.0},
]


def write_scene(path, off, presses):
    sensor = {"name": "arm", "model": "line-900mhz", "off_reflection": off, "clock_hz": 400}
    simulation = {
        "duration_s": 1.3, "snr_db": 10, "static_clutter_db": 50, "clock_offset_ppm": 40,
        "presses": presses,
    }  # fmt: skip
    scene = {"sensors": [sensor], "reference_s": 0.3, "simulation": simulation, **SLOW}
    path.write_text(yaml.safe_dump(scene))


def test_the_off_state_is_found_from_presses(tmp_path):
    """The reader's scene does not know it; forces and locations are not given either."""
    presses = [p | {"location_mm": mm} for p, mm in zip(PRESSES, (25.0, 60.0), strict=True)]
    write_scene(tmp_path / "true.yaml", OFF, presses)
    write_scene(tmp_path / "known.yaml", [0.0, 0.0], [])
    succeeded("simulate", tmp_path / "true.yaml", tmp_path / "air")
    done = succeeded("off-reflection", tmp_path / "air", "--scene", tmp_path / "known.yaml")
    assert done.stdout.startswith("# arm\n")
    # What is printed is what a scene takes.
    found = yaml.safe_load(done.stdout)
    assert found["off_reflection"] == [pytest.approx(pair, abs=0.01) for pair in OFF]
    scene = yaml.safe_load((tmp_path / "known.yaml").read_text())
    scene["sensors"][0] |= found
    assert 0 < load_scene(scene).sensors[0].off_reflection_std < 0.01
