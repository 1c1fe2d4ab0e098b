# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene files: what they may contain, and the one-line error for anything else."""

import copy
import os
import subprocess
import sys

import pytest
import yaml
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.values import as_number
from gnuradio.wiforce.scene import load_scene

MINIMAL = {"sensors": [{"name": "arm", "model": "wiforce-900mhz"}]}
PRESS = {"start_s": 0.8, "hold_s": 0.5, "force_n": 4.0, "location_mm": 45.0}


def changed(dotted, value, scene=None):
    """A copy of a scene (a minimal one with a press) with one key set."""
    scene = copy.deepcopy(scene or MINIMAL | {"simulation": {"presses": [dict(PRESS)]}})
    *parents, last = [int(p) if p.isdigit() else p for p in dotted.split(".")]
    place = scene
    for key in parents:
        place = place[key] if isinstance(key, int) else place.setdefault(key, {})
    place[last] = value
    return scene


def rejection(scene):
    with pytest.raises(InputError) as error:
        load_scene(scene)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_scene_with_automatic_band_is_written_back_as_such():
    """A recording's metadata must not fix what its scene left open."""
    scene = load_scene(MINIMAL | {"environment": {"moving_clutter_hz": "auto"}})
    assert scene.environment.moving_clutter_hz is None
    assert scene.as_dict()["environment"]["moving_clutter_hz"] == "auto"


def test_scene_of_packets_refuses_effects_on_samples():
    """A user would take the readings for those of a radio with an offset."""
    scene = {"packets": {"interval_s": 0.001}, "simulation": {"carrier_offset_hz": 3}}
    scene["sensors"] = [{"name": "arm", "model": "line-2440mhz-calibrated", "clock_hz": 139}]
    scene["radio"] = {"center_frequency_hz": 2.44e9}
    said = rejection(scene)
    assert "simulation.carrier_offset_hz: is not simulated for packets; leave it out" in said


def test_keys_of_a_file_are_read_and_completed(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        """
sounding:   {waveform: wifi, frame_length: 640}
sensors:
  - {name: arm, model: wiforce-900mhz, clock_hz: 1100, off_reflection: [0.1, -0.2]}
  - {name: leg, model: wiforce-900mhz, clock_hz: 1500, off_reflection: [[0.1, 0], [0, 3e-1]]}
environment: {moving_clutter_hz: 30}
simulation:
  truth_model: line-900mhz
  static_clutter_db: null
  presses:
    - {sensor: leg, start_s: 0.8, rise_s: 0.2, hold_s: 0.5, force_n: 4, end_force_n: 6,
       location_mm: 45}
    - {sensor: arm, start_s: 0.8, hold_s: 0.5, force_n: 3, location_mm: 30}
"""
    )
    scene = load_scene(path)
    assert scene.path == path
    assert scene.waveform().name == "wifi" and scene.waveform().frame_length == 640
    assert scene.sensors[0].off_reflection == (0.1 - 0.2j, 0.1 - 0.2j)
    assert scene.sensors[1].off_reflection == (0.1, 0.3j)
    assert scene.sensors[1].load_model(scene).name == "wiforce-900mhz"
    assert scene.simulation.static_clutter_db is None
    assert scene.simulation.moving_clutter_hz == 30
    assert [tag.truth_model for tag in scene.simulation.tags] == ["line-900mhz"] * 2
    first, second = scene.simulation.presses
    assert (first.sensor, first.rise_s, first.end_force_n) == ("leg", 0.2, 6)
    assert first.end_s == pytest.approx(1.7)
    assert (second.rise_s, second.end_force_n) == (0.1, 3)


def test_scene_as_dict_reads_back_equal():
    scene = load_scene(changed("sensors.0.off_reflection", [[0.1, 0.0], [0.0, 0.2]]))
    assert load_scene(yaml.safe_load(yaml.safe_dump(scene.as_dict()))) == scene


@pytest.mark.parametrize(
    ("off", "stated", "std"),
    [
        ([[0.3, 0], [-0.3, 0]], {}, 0.0139),
        ([[0, 0], [0, 0.9]], {}, 0.0271),
        ([[0.3, 0], [-0.3, 0]], {"off_reflection_std": 0}, 0),
        ([0.3, 0], {}, 0),
    ],
)
def test_off_states_that_differ_are_exact_only_where_the_scene_says_so(off, stated, std):
    """Those wrong by 2 % read as force, confidently: 978 of 6150 readings."""
    sensor = {"name": "arm", "model": "wiforce-900mhz", "off_reflection": off} | stated
    scene = load_scene({"sensors": [sensor]})
    assert scene.sensors[0].off_reflection_std == pytest.approx(std)
    assert load_scene(scene.as_dict()).sensors == scene.sensors


@pytest.mark.parametrize("typed", ["", "nan", ".inf", "1_000", "0x10", "1e999", True, None, [1]])
def test_as_number_of_anything_else_is_none(typed):
    assert as_number(typed) is None


@pytest.mark.parametrize(
    "dotted, value, expected",
    [
        ("simulation.presses.0.force", 3, "simulation.presses[0].force: is not a known key"),
        ("radio", [1], "radio: must be a mapping"),
        ("radio.sample_rate_hz", float("nan"), "radio.sample_rate_hz: must be a number"),
        ("sensors", None, "sensors: is missing"),
        ("sensors.0.clock_hz", 2171, "4 x clock_hz must lie below half the snapshot rate"),
        ("environment.moving_clutter_hz", 1200, "above environment.moving_clutter_hz (1200)"),
        ("environment.receive_antennas", 2, "must be 1 when reader_clock is 'shared', got 2"),
        ("environment.reader_clock", "own", "must be 'shared' or 'free', got 'own'"),
        ("sensors.0.model", "arm", "sensors[0].model: must be a .yaml file or a shipped sensor"),
        ("sensors.0.model", "none.yaml", "sensors[0].model: none.yaml: cannot be read"),
        ("simulation.truth_model", "line-2400mhz", "center_frequency_hz: model line-2400mhz: car"),
        ("radio.center_frequency_hz", 2.4e9, "center_frequency_hz: model wiforce-900mhz: carrier"),
        ("simulation.duration_s", 0.03, "must hold at least one phase group (0.036 s)"),
        ("simulation.adc_bits", 17, "simulation.adc_bits: must be an integer from 2 to 16"),
        ("simulation.carrier_offset_hz", 100, "must be 0 when environment.reader_clock is"),
        ("simulation.phase_noise_hz", 1, "must be 0 when environment.reader_clock is"),
        ("simulation.presses.0.sensor", "leg", "presses[0].sensor: must be the name of a sensor"),
        ("simulation.presses.0.location_mm", 80.1, "must lie on the line, 0 to 80 mm, got 80.1"),
        ("simulation.presses.0.start_s", 0.2, "must not begin before reference_s (0.5 s)"),
        ("simulation.presses.0.start_s", 3.0, "must begin before simulation.duration_s (3)"),
        ("simulation.presses", [PRESS, PRESS], "must not overlap another press of sensor 'arm'"),
        ("simulation.tags", [{"sensor": "leg"}], "tags[0].sensor: must be the name of a sensor"),
        ("simulation.tags", [{}, {}], "tags[1].sensor: must not have two entries"),
        ("simulation.tags", [{"truth_model": "leg"}], "tags[arm].truth_model: must be a"),
        # A level without any Doppler would be ignored without a word.
        (
            "simulation",
            {"moving_clutter_db": 20, "moving_clutter_hz": 0},
            "moving_clutter_db: must be null when nothing moves",
        ),
        ("simulation.bursts", {"shortest_s": 3e-3}, "must not be below shortest_s (0.003)"),
        # A typo is reported before any key that it leaves missing.
        ("sensors", [{"clok_hz": 1}], "not a known key, did you mean 'clock_hz'? (known: name"),
    ],
)
def test_scene_with_wrong_value_names_key_and_rule(dotted, value, expected):
    assert expected in rejection(changed(dotted, value))


def test_duration_absent_with_long_groups_is_one_group():
    """A scene for reading alone was refused for a duration that it never stated."""
    scene = changed("phase_group.snapshots", 62500, MINIMAL | {"reference_s": 4.0})
    assert load_scene(scene).simulation.duration_s == pytest.approx(3.6)


def test_tags_not_listed_get_the_defaults_of_the_simulation():
    scene = sensors(1000, 1400)
    scene["simulation"] = {
        "clock_offset_ppm": 7,
        "truth_model": "line-900mhz",
        "tags": [{"sensor": "s1", "level_db": -3, "clock_offset_ppm": 9}],
    }
    first, second = load_scene(scene).simulation.tags
    assert (first.sensor, first.level_db, first.clock_offset_ppm) == ("s0", 0, 7)
    assert (second.sensor, second.level_db, second.clock_offset_ppm) == ("s1", -3, 9)
    assert first.truth_model == second.truth_model == "line-900mhz"


def test_scene_package_import_loads_neither_scipy_nor_gnuradio():
    """Completion in a shell and `gr-wiforce schema` must answer at once."""
    code = "import sys, gnuradio.wiforce.scene; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    heavy = {"scipy", "pandas", "pmt", "gnuradio.gr"}
    assert "gnuradio.wiforce.scene" in done.stdout and not heavy & {*done.stdout.split()}


def sensors(*clocks_hz):
    return {
        "sensors": [
            {"name": f"s{i}", "model": "wiforce-900mhz", "clock_hz": clock}
            for i, clock in enumerate(clocks_hz)
        ]
    }


@pytest.mark.parametrize("clocks_hz", [(1000, 1000), (1000, 1010), (1000, 2000), (400, 1600)])
def test_clocks_with_coinciding_lines_are_rejected(clocks_hz):
    assert "sensors[1].clock_hz: " in rejection(sensors(*clocks_hz))


def test_two_sensors_have_names_and_presses_of_their_own():
    scene = sensors(1000, 1400)
    scene["simulation"] = {"presses": [PRESS | {"sensor": "s0"}, PRESS | {"sensor": "s1"}]}
    load_scene(scene)  # presses of two sensors may overlap
    del scene["simulation"]["presses"][1]["sensor"]
    assert "presses[1].sensor: is missing" in rejection(scene)
    scene["sensors"][1]["name"] = "s0"
    assert "sensors[1].name: must differ" in rejection(scene | {"simulation": {}})


@pytest.mark.parametrize(
    "text, expected",
    [
        ("", "must hold a mapping of keys to values, is empty"),
        ("- 1\n", "must hold a mapping of keys to values, is a list"),
        ("radio: [1, 2", "is not valid YAML at line"),
        ("radio: !!python/object/apply:os.getcwd []", "is not valid YAML"),
        ("radio: {}\nradio: {}\n", "key 'radio' is given twice"),
        ("a: &x [1]\nb: *x\n", "aliases are not allowed"),
        ("a: " + "[" * 60 + "]" * 60, "must not be nested deeper than 16 levels"),
        ("\x00", "is not valid YAML"),
    ],
)
def test_file_that_is_no_plain_mapping_is_rejected_in_one_line(tmp_path, text, expected):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    message = rejection(path)
    assert message.startswith(str(path)) and expected in message


def test_file_missing_binary_or_huge_is_rejected(tmp_path):
    assert rejection("a" * 5000).startswith("scene: must be a .yaml file or a shipped scene")
    assert "cannot be read (No such file" in rejection(tmp_path / "none.yaml")
    assert "cannot be read (Is a directory)" in rejection(tmp_path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes(range(256)))
    assert "is not valid YAML" in rejection(binary)
    huge = tmp_path / "huge.yaml"
    huge.write_bytes(b"#" * 2_000_001)
    assert "must not be larger than 2 MB" in rejection(huge)


def test_pipe_is_rejected_instead_of_waited_for(tmp_path):
    """`plan` of a pipe without a writer never ended."""
    pipe, expected = tmp_path / "pipe.yaml", "pipe.yaml: must be a file, not a pipe or a device"
    os.mkfifo(pipe)
    assert expected in rejection(pipe)
    law = {"strips": [{"sensor": name, "y_mm": y} for name, y in (("a", 0), ("b", 10))]}
    sensors = [
        {"name": name, "model": model, "clock_hz": hz}
        for name, model, hz in (("a", "line-900mhz", 1000), ("b", str(pipe), 1400))
    ]
    assert expected in rejection({"sensors": sensors})
    sensors[1]["model"] = "line-900mhz"
    surface = law | {"spreading_file": str(pipe)}
    assert expected in rejection({"sensors": sensors, "surface": surface})


def test_decimal_comma_between_braces_is_explained(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("sensors: [{name: arm, model: line-900mhz, clock_hz: 1035,5}]\n")
    assert "so write 4.5 and not 4,5" in rejection(path)


def test_model_beside_scene_file_is_found_by_relative_path(tmp_path):
    from gnuradio.wiforce.sensor import load_sensor, write_sensor

    write_sensor(load_sensor("line-900mhz"), tmp_path / "mine.yaml")
    (tmp_path / "scene.yaml").write_text("sensors: [{name: arm, model: mine.yaml}]")
    scene = load_scene(tmp_path / "scene.yaml")
    assert scene.sensors[0].load_model(scene).length_mm == 80
