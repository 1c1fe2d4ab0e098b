# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: what a file may say, and the one line that a wrong one gets."""

import copy

import pytest
import yaml
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.values import as_number
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


def refusal(scene):
    with pytest.raises(InputError) as error:
        load_scene(scene)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_scene_of_sensors_only_gets_every_documented_default():
    scene = load_scene(MINIMAL)
    assert (scene.radio.center_frequency_hz, scene.radio.sample_rate_hz) == (900e6, 12.5e6)
    assert (scene.sounding.waveform, scene.sounding.frame_length) == ("repeated", 720)
    assert scene.phase_group.snapshots == 625
    assert scene.group_period_s == pytest.approx(0.036, rel=1e-12)
    (sensor,) = scene.sensors
    assert (sensor.clock_hz, sensor.clock_tolerance_ppm) == (1000, 100)
    assert sensor.off_reflection == (0, 0)
    assert scene.environment.moving_clutter_hz == 0
    assert scene.environment.reader_clock == "shared"
    assert scene.reference_s == 0.5
    simulation = scene.simulation
    assert (simulation.duration_s, simulation.seed, simulation.snr_db) == (3.0, 1, 10)
    assert (simulation.static_clutter_db, simulation.moving_clutter_db) == (60, None)
    assert simulation.adc_bits == 14
    (tag,) = simulation.tags
    assert tag.truth_model == "wiforce-900mhz"
    assert (tag.clock_offset_ppm, tag.clock_drift_ppm_per_s) == (40, 0.1)
    assert simulation.presses == ()


def test_the_scene_of_the_specification_is_read_key_by_key(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        """
radio:      {center_frequency_hz: 900e6, sample_rate_hz: 12.5e+6}
sounding:   {waveform: wifi, frame_length: 640}
phase_group: {snapshots: 63}
sensors:
  - {name: arm, model: wiforce-900mhz, clock_hz: 1100, clock_tolerance_ppm: 50,
     off_reflection: [0.1, -0.2]}
  - {name: leg, model: wiforce-900mhz, clock_hz: 1500, off_reflection: [[0.1, 0], [0, 3e-1]]}
environment: {moving_clutter_hz: 30, reader_clock: free}
reference_s: 0.4
simulation:
  truth_model: line-900mhz
  duration_s: 2
  seed: 9
  snr_db: -3
  static_clutter_db: null
  moving_clutter_db: 20
  clock_offset_ppm: -7
  clock_drift_ppm_per_s: 0.2
  adc_bits: 12
  presses:
    - {sensor: leg, start_s: 0.8, rise_s: 0.2, hold_s: 0.5, force_n: 4, end_force_n: 6,
       location_mm: 45}
    - {sensor: arm, start_s: 0.8, hold_s: 0.5, force_n: 3, location_mm: 30}
"""
    )
    scene = load_scene(path)
    assert scene.path == path
    assert scene.radio.center_frequency_hz == 900e6
    assert scene.waveform().name == "wifi" and scene.waveform().frame_length == 640
    assert scene.phase_group.snapshots == 63
    assert scene.sensors[0].off_reflection == (0.1 - 0.2j, 0.1 - 0.2j)
    assert scene.sensors[1].off_reflection == (0.1, 0.3j)
    assert scene.sensors[1].load_model(scene).name == "wiforce-900mhz"
    assert scene.environment.reader_clock == "free"
    assert scene.simulation.static_clutter_db is None
    assert scene.simulation.moving_clutter_hz == 30
    assert [tag.truth_model for tag in scene.simulation.tags] == ["line-900mhz"] * 2
    first, second = scene.simulation.presses
    assert (first.sensor, first.rise_s, first.end_force_n) == ("leg", 0.2, 6)
    assert first.end_s == pytest.approx(1.7)
    assert (second.rise_s, second.end_force_n) == (0.1, 3)


def test_a_scene_written_out_with_its_defaults_reads_back_the_same():
    scene = load_scene(changed("sensors.0.off_reflection", [[0.1, 0.0], [0.0, 0.2]]))
    assert load_scene(yaml.safe_load(yaml.safe_dump(scene.as_dict()))) == scene


@pytest.mark.parametrize("typed", ["900e6", "9e8", "900000000", "900.0e+6", " 9.0E8 "])
def test_numbers_that_yaml_takes_for_text_are_read_as_numbers(typed):
    assert load_scene(changed("radio.center_frequency_hz", typed)).radio.center_frequency_hz == 9e8


@pytest.mark.parametrize("typed", ["", "nan", ".inf", "1_000", "0x10", "1e999", True, None, [1]])
def test_what_is_no_finite_number_is_not_taken_for_one(typed):
    assert as_number(typed) is None


@pytest.mark.parametrize(
    "dotted, value, told",
    [
        ("radios", {}, "radios: is not a known key"),
        ("sounding.wavform", "wifi", "sounding.wavform: is not a known key"),
        ("sensors.0.clok_hz", 1000, "sensors[0].clok_hz: is not a known key"),
        ("simulation.presses.0.force", 3, "simulation.presses[0].force: is not a known key"),
        ("radio", [1], "radio: must be a mapping"),
        ("radio.sample_rate_hz", "fast", "radio.sample_rate_hz: must be a number"),
        ("radio.sample_rate_hz", float("nan"), "radio.sample_rate_hz: must be a number"),
        ("radio.sample_rate_hz", -1, "got -1"),
        ("radio.center_frequency_hz", True, "must be a number"),
        ("sounding.waveform", "chirp", "must be 'repeated' or 'wifi', got 'chirp'"),
        ("sounding.frame_length", 319, "sounding.frame_length: must be an integer from 320"),
        ("sounding.frame_length", 720.5, "must be an integer"),
        ("phase_group.snapshots", 3, "phase_group.snapshots: must be an integer from 32"),
        ("sensors", [], "sensors: must be a list of 1 to 16"),
        ("sensors", None, "sensors: is missing"),
        ("sensors", {"name": "arm"}, "sensors: must be a list"),
        ("sensors.0.name", "", "sensors[0].name: must be printable text"),
        ("sensors.0.name", "a\nb", "sensors[0].name: must be printable text"),
        ("sensors.0.name", 7, "sensors[0].name: must be printable text"),
        ("sensors.0.model", None, "sensors[0].model: is missing"),
        ("sensors.0.clock_hz", 0, "sensors[0].clock_hz: must be a number above 0"),
        ("sensors.0.clock_hz", 2171, "4 x clock_hz must lie below half the snapshot rate"),
        ("sensors.0.clock_tolerance_ppm", -1, "sensors[0].clock_tolerance_ppm"),
        ("sensors.0.off_reflection", [1.0, 0.0], "off_reflection: must be a pair [re, im]"),
        ("sensors.0.off_reflection", 0.1, "off_reflection: must be a pair [re, im]"),
        ("sensors.0.off_reflection", [[0, 0], [0, 0], [0, 0]], "off_reflection: must be a pair"),
        ("environment.moving_clutter_hz", 1200, "above environment.moving_clutter_hz (1200)"),
        ("environment.receive_antennas", 2, "must be 1 when reader_clock is 'shared', got 2"),
        ("environment.reader_clock", "own", "must be 'shared' or 'free', got 'own'"),
        ("environment.weather", "rain", "environment.weather: is not a known key"),
        ("sensors.0.model", "arm", "sensors[0].model: must be a .yaml file or one of fingertip-"),
        ("sensors.0.model", "none.yaml", "sensors[0].model: none.yaml: cannot be read"),
        ("simulation.truth_model", "leg", "simulation.truth_model: must be a .yaml file or one"),
        ("simulation.truth_model", "line-2400mhz", "center_frequency_hz: model line-2400mhz: car"),
        ("radio.center_frequency_hz", 2.4e9, "center_frequency_hz: model wiforce-900mhz: carrier"),
        ("simulation.presses.0.tremor_n", -1, "presses[0].tremor_n: must be a number"),
        ("reference_s", -0.1, "reference_s: must be a number"),
        ("simulation.duration_s", 0, "simulation.duration_s: must be a number above 0"),
        ("simulation.duration_s", 0.03, "must hold at least one phase group (0.036 s)"),
        ("simulation.seed", -1, "simulation.seed: must be an integer"),
        ("simulation.seed", 1.5, "simulation.seed: must be an integer"),
        ("simulation.adc_bits", 17, "simulation.adc_bits: must be an integer from 2 to 16"),
        ("simulation.moving_clutter_db", 20, "moving_clutter_db: must be null when nothing moves"),
        (
            "simulation.carrier_offset_hz",
            100,
            "must be 0 when environment.reader_clock is",
        ),
        ("simulation.phase_noise_hz", 1, "must be 0 when environment.reader_clock is"),
        ("simulation.truth_model", "no-such", "no-such"),
        ("simulation.presses.0.sensor", "leg", "presses[0].sensor: must be the name of a sensor"),
        ("simulation.presses.0.location_mm", 80.1, "must lie on the line, 0 to 80 mm, got 80.1"),
        ("simulation.presses.0.location_mm", -1, "presses[0].location_mm: must be a number"),
        ("simulation.presses.0.force_n", 0, "presses[0].force_n: must be a number above 0"),
        ("simulation.presses.0.hold_s", None, "presses[0].hold_s: is missing"),
        ("simulation.presses.0.start_s", 0.2, "must not begin before reference_s (0.5 s)"),
        ("simulation.presses.0.start_s", 3.0, "must begin before simulation.duration_s (3)"),
        ("simulation.presses", [PRESS, PRESS], "must not overlap another press of sensor 'arm'"),
        ("simulation.tags", [{"sensor": "leg"}], "tags[0].sensor: must be the name of a sensor"),
        ("simulation.tags", [{}, {}], "tags[1].sensor: must not have two entries"),
        ("simulation.moves", [{"start_s": 1}], "moves[0].distance_mm: is missing"),
    ],
)
def test_a_wrong_scene_is_refused_by_key_and_rule(dotted, value, told):
    assert told in refusal(changed(dotted, value))


def test_a_clock_just_below_nyquist_is_accepted_and_just_above_is_not():
    nyquist_hz = 12.5e6 / 720 / 2
    load_scene(changed("sensors.0.clock_hz", nyquist_hz / 4 * 0.9999))
    assert "8680.56" in refusal(changed("sensors.0.clock_hz", nyquist_hz / 4 * 1.0001))


def sensors(*clocks_hz):
    return {
        "sensors": [
            {"name": f"s{i}", "model": "wiforce-900mhz", "clock_hz": clock}
            for i, clock in enumerate(clocks_hz)
        ]
    }


@pytest.mark.parametrize("second_hz", [1400, 1790, 1200, 1250])
def test_tags_whose_main_lines_lie_apart_may_share_a_scene(second_hz):
    load_scene(sensors(1000, second_hz))


@pytest.mark.parametrize("clocks_hz", [(1000, 1000), (1000, 1010), (1000, 2000), (400, 1600)])
def test_tags_that_could_not_be_told_apart_are_refused(clocks_hz):
    assert "sensors[1].clock_hz: " in refusal(sensors(*clocks_hz))


def test_two_sensors_of_one_name_are_refused():
    scene = sensors(1000, 1400)
    scene["sensors"][1]["name"] = "s0"
    assert "sensors[1].name: must differ" in refusal(scene)


def test_presses_of_different_sensors_may_overlap_and_must_name_theirs():
    scene = sensors(1000, 1400)
    scene["simulation"] = {"presses": [PRESS | {"sensor": "s0"}, PRESS | {"sensor": "s1"}]}
    load_scene(scene)
    del scene["simulation"]["presses"][1]["sensor"]
    assert "presses[1].sensor: is missing" in refusal(scene)


@pytest.mark.parametrize(
    "text, told",
    [
        ("", "must hold a mapping of keys to values, is empty"),
        ("- 1\n", "must hold a mapping of keys to values, is a list"),
        ("radio: [1, 2", "is not valid YAML at line"),
        ("radio: !!python/object/apply:os.getcwd []", "is not valid YAML"),
        ("radio: {}\nradio: {}\n", "key 'radio' is given twice"),
        ("a: &x [1]\nb: *x\n", "aliases are not allowed"),
        ("a: " + "[" * 60 + "]" * 60, "must not be nested deeper than 16 levels"),
        ("a: " + "[" * 5000, "is not valid YAML"),
        ("\x00", "is not valid YAML"),
        ("a: 2024-99-99", "is not valid YAML"),
    ],
)
def test_a_file_that_is_no_plain_yaml_mapping_is_refused_in_one_line(tmp_path, text, told):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    message = refusal(path)
    assert message.startswith(str(path)) and told in message


def test_a_missing_a_binary_and_a_huge_file_are_refused(tmp_path):
    assert "cannot be read (No such file" in refusal(tmp_path / "none.yaml")
    assert "cannot be read (Is a directory)" in refusal(tmp_path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes(range(256)))
    assert "is not valid YAML" in refusal(binary)
    huge = tmp_path / "huge.yaml"
    huge.write_bytes(b"#" * 2_000_001)
    assert "must not be larger than 2 MB" in refusal(huge)


def test_a_model_beside_the_scene_file_is_found_by_relative_path(tmp_path):
    from gnuradio.wiforce.sensor import load_sensor, write_sensor

    write_sensor(load_sensor("line-900mhz"), tmp_path / "mine.yaml")
    (tmp_path / "scene.yaml").write_text("sensors: [{name: arm, model: mine.yaml}]")
    scene = load_scene(tmp_path / "scene.yaml")
    assert scene.sensors[0].load_model(scene).length_mm == 80
