# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that versions before 1.0 wrote are read as they were then (docs/install.md)."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_runs import succeeded
from gnuradio.wiforce.io.capture import Capture
from gnuradio.wiforce.scene import load_scene, scene_of
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.file import write_sensor
from gnuradio.wiforce.sensor.location import SHAPES

# Copies of files as they were stored in the repository at different times.
FILES = Path(__file__).resolve().parent / "earlier_files"

# Phases (deg) of ports 1 and 2 and their standard deviations for 3.5 N at 28 mm and 6 N at 37 mm,
# computed by the version that wrote the files.
PRESSES = (np.array([3.5, 6.0]), np.array([28.0, 37.0]))
SENSORS = {
    "sensor-rows": (
        [[10.940081, 38.777926], [-17.229237, 12.477222]],
        [[4.045149, 10.455007], [2.122869, 5.129245]],
    ),
    "sensor-64-rows": (
        [[115.820967, 67.757453], [101.027861, 87.277596]],
        [[0.373825, 0.199947], [0.336754, 0.195263]],
    ),
    "sensor-line": (
        [[138.197725, 73.789223], [117.486955, 98.985934]],
        [[0.0, 0.0], [0.0, 0.0]],
    ),
}


@pytest.mark.parametrize("name", SENSORS)
def test_earlier_sensor_gives_phases_and_errors_of_the_version_that_wrote_it(name):
    """A user would have to press the sensor at every location again."""
    model = load_sensor(FILES / f"{name}.yaml")
    phases, std = SENSORS[name]
    assert np.allclose(model.phases_deg(*PRESSES), phases, rtol=0, atol=2e-6)
    assert np.allclose(model.model_std_deg(*PRESSES), std, rtol=0, atol=2e-6)


def test_earlier_sensor_written_again_has_the_present_keys_and_phases(tmp_path):
    """`gr-wiforce transfer` writes sensors that it has read."""
    model = load_sensor(FILES / "sensor-64-rows.yaml")
    rows = yaml.safe_load((FILES / "sensor-64-rows.yaml").read_text())["carriers"][0]
    write_sensor(model, tmp_path / "again.yaml")
    (carrier,) = yaml.safe_load((tmp_path / "again.yaml").read_text())["carriers"]
    assert len(carrier["interpolation"]) == len(rows["interpolation"]) == 64
    assert {row["shape"] for row in carrier["interpolation"]} == set(SHAPES)
    again = load_sensor(tmp_path / "again.yaml")
    assert np.allclose(again.phases_deg(*PRESSES), model.phases_deg(*PRESSES), rtol=0, atol=1e-6)


def test_earlier_law_of_a_skin_is_accepted_without_positions_of_its_strips():
    """The skin would have to be pressed again."""
    scene = load_scene("surface_four_strips").as_dict()
    scene["surface"] |= {"spreading": None, "spreading_file": str(FILES / "skin.yaml")}
    law = load_scene(scene).surface.law(Path())
    assert (law.strip_y_mm, law.strip_sensors) == (None, None)
    assert law.share_of(3, 0.0) == pytest.approx(0.51761)


def test_earlier_scenes_keep_what_they_state():
    """A measurement that was planned with an earlier version could not be repeated."""
    first = load_scene(FILES / "scene-first.yaml")
    assert first.radio.center_frequency_hz == 900e6 and first.sounding.frame_length == 720
    assert first.environment.moving_clutter_hz == 0 and first.sensors[0].clock_hz == 1000
    assert [press.location_mm for press in first.simulation.presses] == [45.0, 33.0]
    room = load_scene(FILES / "scene-room.yaml")
    assert room.simulation.lamps.level_db == 10 and room.simulation.ripple.percent == 1


def test_scene_of_an_earlier_capture_is_read_and_its_keys_kept():
    """The capture itself could not be read: it holds its scene with every key of that time."""
    stored = json.loads((FILES / "scene-of-a-capture.json").read_text())
    capture = Capture(Path("press.sigmf-data"), "ci16_le", 12.5e6, 900e6, (), stored)
    scene, differences = scene_of(capture)
    assert differences == []
    # Reflections without an imaginary part are written as one number today.
    assert stored["sensors"][0].pop("off_reflection") == [[0.0, 0.0], [0.0, 0.0]]
    assert scene.sensors[0].off_reflection == (0, 0)
    _assert_holds(scene.as_dict(), stored)


def _assert_holds(now, then):
    """All values of a mapping or list are in a later one, which may have more keys."""
    if isinstance(then, dict):
        for key, value in then.items():
            assert key in now, key
            _assert_holds(now[key], value)
    elif isinstance(then, list):
        assert len(now) == len(then)
        for one, other in zip(now, then, strict=True):
            _assert_holds(one, other)
    else:
        assert now == then


def test_earlier_readings_are_exported_with_what_they_have(tmp_path):
    """Tables of earlier versions have no columns `group` and `interference`."""
    succeeded("export", FILES / "readings.csv", "-o", tmp_path / "readings.jsonl")
    rows = [json.loads(line) for line in (tmp_path / "readings.jsonl").read_text().splitlines()]
    assert [row["force_n"] for row in rows] == [None, 4.021, 4.48]
    assert [row["flags"] for row in rows] == ["reference", "", "transition"]
    assert rows[0]["group"] is None and rows[0]["interference"] is None
