# SPDX-License-Identifier: GPL-3.0-or-later
"""Declared files: parser, JSON Schema, documentation tables and defaults say the same."""

import copy
import dataclasses
import json
from contextlib import nullcontext
from functools import cache
from pathlib import Path

import jsonschema
import pytest
import yaml
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.schema import ListOf, Mapping, keys
from gnuradio.wiforce.io.text.values import KeyPath, Scope
from gnuradio.wiforce.scene import Scene, load_scene, scene_json_schema
from gnuradio.wiforce.scene.schema import Radio
from gnuradio.wiforce.sensor import sensor_from_dict
from gnuradio.wiforce.sensor.file import MODELS, sensor_json_schema
from wiforce_app.main import main

SCENE_SCHEMA, SENSOR_SCHEMA = map(
    jsonschema.Draft7Validator, (scene_json_schema(), sensor_json_schema())
)
DOCS = Path(__file__).resolve().parents[3] / "docs"
SCENES, SENSORS = (sorted(Path(DATA_DIR).glob(f"{kind}/*.yaml")) for kind in ("scenes", "sensors"))
SCENE = {
    "radio": {"sample_rate_hz": 12.5e6},
    "sensors": [{"name": "arm", "model": "wiforce-900mhz", "off_reflection": [0.1, 0.2]}],
    "simulation": {
        "presses": [{"start_s": 0.8, "hold_s": 0.5, "force_n": 4.0, "location_mm": 45.0}],
        "tags": [{"sensor": "arm", "clock2_duty": "pulses"}],
    },
}


@cache
def content_of(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def changed(values, dotted, value):
    """A copy of a mapping with one key set, or deleted where the value is `...`."""
    values = copy.deepcopy(values)
    *parents, last = [int(part) if part.isdigit() else part for part in dotted.split(".")]
    inner = values
    for part in parents:
        inner = inner[part] if isinstance(part, int) else inner.setdefault(part, {})
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    return values


def schema_accepts(schema, values):
    """Whether an editor would; its YAML 1.2 reads a date as text."""
    return schema.is_valid(json.loads(json.dumps(values, default=str)))


def check_both(load, schema, values, good):
    """The parser and an editor accept good values, and refuse others."""
    with nullcontext() if good else pytest.raises(InputError):
        load(values)
    assert schema_accepts(schema, values) is good


def test_json_schemas_accept_what_is_shipped_and_written_with_defaults():
    for schema, paths in ((SCENE_SCHEMA, SCENES), (SENSOR_SCHEMA, SENSORS)):
        schema.check_schema(schema.schema)
        for path in paths:
            schema.validate(content_of(path))
    for path in SCENES[:3]:
        SCENE_SCHEMA.validate(load_scene(path).as_dict())


@pytest.mark.parametrize(
    "dotted, value, good",
    [
        ("radio", None, True),
        ("radio", [1], False),
        ("radio.center_frequency_hz", "900e6", True),
        ("radio.center_frequency_hz", "fast", False),
        ("radio.sample_rate_hz", True, False),
        ("radio.rate_hz", 1e6, False),
        ("sounding.waveform", "chirps", False),
        ("sounding.frame_length", 640.0, True),
        ("sounding.frame_length", 640.5, False),
        ("sensors", ..., False),
        ("sensors", [], False),
        ("sensors.0.name", "a\nb", False),
        ("sensors.0.name", "x" * 65, False),
        ("sensors.0.clock_hz", 0, False),
        ("sensors.0.off_reflection", [[0.1, 0], [0, 0.2]], True),
        ("sensors.0.off_reflection", [1.0, 0], False),
        ("sensors.0.off_reflection", [[0, 0], [0, 0], [0, 0]], False),
        ("simulation.presses", None, True),
        ("simulation.tags.0.clock_phase_deg", None, True),
        ("simulation.bursts", {}, True),
        ("simulation.bursts.share", 1, False),
        ("simulation.other_tags", [{"clock_hz": 1000}], True),
        ("simulation.tags.0.beam", {"creep": 0.1}, True),
        ("simulation.seed", 2**63 - 1, True),
    ],
)
def test_json_schema_and_parser_agree_on_scene(dotted, value, good):
    check_both(load_scene, SCENE_SCHEMA, changed(SCENE, dotted, value), good)


@pytest.mark.parametrize(
    "name, dotted, value, good",
    [
        ("line-900mhz", "kind", "magic", False),
        ("line-900mhz", "length_mm", -80, False),
        ("line-900mhz", "contact.asymmetry", 1, False),
        ("line-900mhz", "frequencies_hz", ["900e6", 2.4e9], True),
        ("line-900mhz", "port_offset_deg", [0, 0, 0], False),
        ("line-900mhz", "provenance.assumed", ..., True),
        ("line-900mhz", "provenance.assumed", [1], False),
        ("wiforce-900mhz", "cross_validation", ..., True),
        ("wiforce-900mhz", "cross_validation.locations.0.port", 3, False),
        ("wiforce-900mhz", "cross_validation.locations.0.rms_deg", "2.5", True),
        ("wiforce-900mhz", "cross_validation.wrong", [{"location_mm": 40}], False),
        ("wiforce-900mhz", "knots_n", None, True),
        ("wiforce-900mhz", "carriers.0.noise_deg", [1, 1e300], False),
        ("wiforce-900mhz", "carriers.0.coefficients_deg", [[[1]]], False),
    ],
)
def test_json_schema_and_parser_agree_on_sensor(name, dotted, value, good):
    path = next(path for path in SENSORS if path.stem == name)
    check_both(sensor_from_dict, SENSOR_SCHEMA, changed(content_of(path), dotted, value), good)


def declared_keys(cls, prefix=""):
    """Every key of a declared mapping and of those in it, by dotted name."""
    for name, key in keys(cls).items():
        yield f"{prefix}{name}", key
        held = key.type.item if isinstance(key.type, ListOf) else key.type
        if isinstance(held, Mapping):
            yield from declared_keys(held.of, f"{prefix}{name}.")


@pytest.mark.parametrize("cls", [Scene, *MODELS.values()])
def test_declared_keys_are_documented_and_their_defaults_keep_their_rules(cls):
    for dotted, key in declared_keys(cls):
        assert key.doc.endswith("."), dotted
        if key.default is not dataclasses.MISSING:
            written = key.type.plain(key.default)
            read_back = key.type.read(written, KeyPath("default", dotted), Scope())
            assert read_back == key.default, dotted


@pytest.mark.parametrize("page", ["reference/scenes.md", "sensors.md", "tutorial.md"])
def test_yaml_examples_in_documentation_are_valid(page):
    blocks = (DOCS / page).read_text(encoding="utf-8").split("```yaml\n")[1:]
    examples = [yaml.safe_load(block.partition("```")[0]) for block in blocks]
    # Those of surfaces need files; qa_docs.py loads them.
    examples = [each for each in examples if page != "sensors.md" or "kind" in each]
    assert examples
    for example in examples:
        if "kind" in example:
            sensor_from_dict(example)
            assert schema_accepts(SENSOR_SCHEMA, example)
        else:
            assert schema_accepts(SCENE_SCHEMA, example)
            example["sensors"][0]["model"] = "line-900mhz"
            load_scene(example)


def test_schema_command_prints_the_json_schema(capsys):
    for kind, schema in (("scene", scene_json_schema), ("sensor", sensor_json_schema)):
        assert main(["schema", kind]) == 0
        assert json.loads(capsys.readouterr().out) == schema()


def test_declared_mapping_behaves_as_frozen_dataclass():
    """Scenes are compared, used as keys and changed by `replace`, but never in place."""
    radio = Radio(sample_rate_hz=1e6)
    assert dataclasses.replace(radio, sample_rate_hz=12.5e6) == Radio() != radio
    assert {radio: 1}[copy.deepcopy(radio)] == 1
    with pytest.raises(dataclasses.FrozenInstanceError, match="'sample_rate_hz'"):
        radio.sample_rate_hz = 2e6
