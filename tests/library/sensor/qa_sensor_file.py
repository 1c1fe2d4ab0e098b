# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor files: what is written is read back equal, and wrong files are rejected by key."""

import copy
import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor import load_sensor, shipped_sensors, write_sensor
from modules import module_of

FORCES, PLACES = np.linspace(0.5, 9, 40)[:, None], np.linspace(20, 60, 21)


def test_shipped_sensors_load_and_state_their_provenance():
    assert {
        "line-900mhz",
        "line-2400mhz",
        "paper-900mhz",
        "paper-2400mhz",
        "wiforce-900mhz",
        "wiforce-2400mhz",
    } <= set(shipped_sensors())
    for name in shipped_sensors():
        model = load_sensor(name)
        assert model.name == name and model.length_mm == 80
        assert model.provenance["source"] and model.provenance["date"]
        assert np.all(np.isfinite(model.phases_deg(FORCES, PLACES)))
    for name in ("wiforce-900mhz", "wiforce-2400mhz"):
        assumed = " ".join(load_sensor(name).provenance["assumed"])
        assert "location steps those of the line" in assumed and "untouched phases" in assumed


def test_shipped_sensors_equal_those_of_their_generator(long_run):
    generator = module_of(Path(DATA_DIR) / "sensors" / "make_sensors.py")
    some = [generator.line_calibrated(900), generator.published("wiforce", 2400)]
    for made in generator.all_sensors() if long_run else some:
        shipped = load_sensor(made.name)
        difference = made.phases_deg(FORCES, PLACES) - shipped.phases_deg(FORCES, PLACES)
        assert np.abs(difference).max() < 1e-3, made.name
        difference = made.model_std_deg(FORCES, PLACES) - shipped.model_std_deg(FORCES, PLACES)
        assert np.abs(difference).max() < 1e-3, made.name
        assert shipped.provenance == made.provenance
        assert shipped.onset_force_n == pytest.approx(made.onset_force_n, abs=1e-6)


@pytest.mark.parametrize("name", ["line-900mhz", "wiforce-2400mhz", "line-900mhz-calibrated"])
def test_sensor_written_to_file_reads_back_equal(tmp_path, name):
    model = load_sensor(name)
    write_sensor(model, tmp_path / "s.yaml")
    again = load_sensor("s.yaml", relative_to=tmp_path)
    assert np.abs(model.phases_deg(FORCES, PLACES) - again.phases_deg(FORCES, PLACES)).max() < 1e-5
    assert again.untouched_deg() == pytest.approx(model.untouched_deg(), abs=1e-6)
    assert again.force_span_n == pytest.approx(model.force_span_n)
    assert again.provenance == model.provenance


def test_sensors_of_another_provenance_are_equal():
    """A model is what it reads, and a key of caches that programs have."""
    model = load_sensor("line-900mhz")
    other = dataclasses.replace(model, provenance=model.provenance | {"source": "another table"})
    assert other == model and hash(other) == hash(model)
    assert dataclasses.replace(model, onset_force_n=0.7) != model


def test_sensor_file_is_parsed_once_until_it_changes(tmp_path):
    """A start reads a sensor file three times; a file that was replaced must count at once."""
    path = tmp_path / "own.yaml"
    model = load_sensor("line-900mhz")
    write_sensor(model, path)
    assert load_sensor(path) is load_sensor(path)
    write_sensor(dataclasses.replace(model, onset_force_n=0.7), path)
    assert load_sensor(path).onset_force_n == 0.7


def test_wiforce_sensors_have_measured_movement_and_line_steps():
    # published movement at 20 mm, 900 MHz: phase of port 1 rises by 10.9 deg from 3 to 6 N
    for name, two_beta in (("wiforce-900mhz", 2.1614), ("wiforce-2400mhz", 5.7638)):
        wiforce = load_sensor(name)
        paper = load_sensor(name.replace("wiforce", "paper"))
        for place in (20.0, 40.0):
            moved = [np.diff(m.phases_deg([4.0, 6.0], place), axis=0) for m in (wiforce, paper)]
            assert moved[0] == pytest.approx(moved[1], abs=1e-6)
        anchor = 4.806 if "900" in name else 5.59
        steps = np.diff(wiforce.phases_deg(anchor, [20.0, 40.0, 60.0]), axis=0)
        steps_deg = np.array([[-20 * two_beta, 20 * two_beta]] * 2)
        assert np.abs(np.exp(1j * np.radians(steps - steps_deg)) - 1).max() < np.radians(0.1)


@cache
def content(name="wiforce-900mhz"):
    return yaml.safe_load((Path(DATA_DIR) / "sensors" / f"{name}.yaml").read_text())


def changed(path, value, name="wiforce-900mhz"):
    result = copy.deepcopy(content(name))
    *parents, last = path
    inner = result
    for key in parents:
        inner = inner[key]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return result


def load(tmp_path, values):
    path = tmp_path / "sensor.yaml"
    path.write_text(yaml.safe_dump(values))
    return load_sensor(path)


@pytest.mark.parametrize(
    "path, value, expected",
    [
        (["kind"], "magic", "kind: must be 'line' or 'curves'"),
        (["colour"], "red", "colour: is not a known key"),
        (["onset_force_n"], None, "onset_force_n: is missing"),
        (["onset_force_n"], 12.0, "onset_force_n: must be below the highest calibrated force"),
        (["force_span_n"], [8, 2], "force_span_n: must be two rising numbers"),
        (["location_span_mm"], [20, 90], "location_span_mm"),
        (["carriers", 0, "location_mm"], [20, 60, 40], "carriers[0].location_mm"),
        (["carriers", 0, "coefficients_deg"], [[1, 2], [3, 4]], "carriers[0].coefficients_deg"),
        (["carriers", 0, "interpolation"], [[0, 1, 1, 1, 0.5, 1]], "sum to 1"),
        (["carriers", 0, "interpolation"], [[0, 1, 1, 1, 1]], "[0]: must be a row of 6 numbers"),
        (["carriers", 0, "interpolation"], [[5, 1, 1, 1, 1, 1]], "number of a shape, 0 to 4"),
        (["carriers", 0, "interpolation", 0, "probability"], 0.01, "sum to 1"),
        (["provenance", "date"], None, "provenance.date"),
        (["form"], "cubic", "knots_n: must be at least two rising positive forces"),
        (["knots_n"], [1, 2], "knots_n: must be left out where form is 'power'"),
        (["carriers", 0, "covariance_deg2", 0, 0, 0, 0], -9, "must hold symmetric, non-negative"),
        (["carriers", 0, "frequency"], 9e8, "did you mean 'frequency_hz'?"),
        (["cross_validation", "locations", 0], None, "must hold each of its locations at both"),
        (["contact", "width_mm"], 81, "contact.width_mm: must not be wider than length_mm, 80"),
    ],
)
def test_sensor_with_wrong_value_names_key_and_rule(tmp_path, path, value, expected):
    name = "line-900mhz" if path[0] == "contact" else "wiforce-900mhz"
    with pytest.raises(InputError) as caught:
        load(tmp_path, changed(path, value, name))
    assert expected in str(caught.value) and "sensor.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sensor_name_or_carrier_unknown_is_rejected(tmp_path):
    with pytest.raises(InputError, match="did you mean 'wiforce-9..mhz'"):
        load_sensor("wiforce-901mhz")
    with pytest.raises(InputError, match="cannot be read"):
        load_sensor(tmp_path / "none.yaml")
    model = load_sensor("wiforce-900mhz")
    assert model.phases_deg(4.0, 40.0, 900.5e6).shape == (2,)
    with pytest.raises(InputError, match="carrier must be within 0.1 % of 900 MHz"):
        model.phases_deg(4.0, 40.0, 915e6)


@pytest.mark.parametrize(
    ("name", "folder", "rule"),
    [
        ("bad\udcff", "", "a.yaml: name: must be printable text of 1 to 255"),
        ("two\nlines", "", "a.yaml: name: must be printable text of 1 to 255"),
        ("arm", "no", "cannot be written"),
    ],
)
def test_write_sensor_refuses_a_file_that_could_not_be_read(tmp_path, name, folder, rule):
    model = dataclasses.replace(load_sensor("line-900mhz"), name=name)
    with pytest.raises(InputError, match=rule):
        write_sensor(model, tmp_path / folder / "a.yaml")
    assert not list(tmp_path.iterdir())
