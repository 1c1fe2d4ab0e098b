# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the package: blocks, what their parameters are made with, and the rules on those."""

import pickle
import subprocess
import sys

import pytest
import yaml
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.receiver.stream import StreamReader
from gnuradio.wiforce.scene import load_scene

SHORT = {
    "radio": {"sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 300}],
    "reference_s": 0.16,
    "simulation": {"duration_s": 0.24, "snr_db": 20},
}


def test_package_name_means_the_block_after_its_module_was_imported():
    """Each in a fresh interpreter: the import system binds a file's module to the same name."""
    code = (
        "from gnuradio import wiforce\n"
        "wiforce.plan, wiforce.reader, wiforce.force_inversion\n"
        "for name in ('end_separation', 'reader', 'force_inversion', 'conjugate_difference'):\n"
        "    for _ in range(2):\n"
        "        assert isinstance(getattr(wiforce, name), type), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


def test_rules_refuse_what_the_constructors_refuse(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("sensors: [{name: arm, model: nowhere}]\n")
    for scene in ("missing.yaml", "dome", broken, 3, {}):
        assert not wiforce.is_scene(scene)
    for model in ("missing.yaml", "wiforce-800mhz", 3):
        assert not wiforce.is_carrier_of(model, 900e6)
    sensor = {"name": "arm", "model": "line-900mhz"}
    assert wiforce.is_scene({"sensors": [sensor]})
    # A key that is refused when it is read, and a scene that cannot be planned.
    for wrong in ({"phase_group": {"snapshots": 0}}, {"sensors": [sensor | {"clock_hz": 3000.0}]}):
        assert not wiforce.is_scene({"sensors": [sensor]} | wrong)


def test_rules_tell_values_that_a_block_takes_from_those_that_it_refuses():
    """Companion marks a parameter red by these rules before a flowgraph is run."""
    assert [wiforce.is_carrier_of("line-900mhz", hz) for hz in (900e6, 5e9)] == [True, False]
    lengths = (0, 256)
    assert [wiforce.is_waveform("chirp", 720, symbol_length=n) for n in lengths] == [True, False]
    assert [wiforce.is_amplitude_of("repeated", a) for a in (0.5, 2.0)] == [True, False]
    assert not wiforce.is_capture("missing")
    assert [wiforce.symbol_length_of(*a) for a in (("wifi",), ("chirp", 256))] == [64, 256]


def test_receivers_and_simulation_accept_the_scenes_that_read_accepts(tmp_path):
    """A scene's name gave an AttributeError wherever it was not loaded or planned before."""
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SHORT))
    for scene in (SHORT, tmp_path / "scene.yaml", str(tmp_path / "scene.yaml"), load_scene(SHORT)):
        for receiver in (wiforce.Receiver, StreamReader):
            assert receiver(scene).plan.group_length == 125
        assert len(wiforce.simulate(scene, tmp_path / "press", overwrite=True)) == 3
        reader = RecordingReader(open_capture(tmp_path / "press"), scene, frame_offset=0)
        assert reader.plan.group_length == 125
    assert wiforce.Receiver("demo").plan.scene == load_scene("demo")


@pytest.mark.parametrize("wrong", [None, 3, ["demo"]])
def test_library_anything_but_a_scene_or_file_is_refused_by_the_parameter(tmp_path, wrong):
    for call in (
        wiforce.plan,
        wiforce.Receiver,
        StreamReader,
        lambda scene: wiforce.simulate(scene, tmp_path / "press"),
    ):
        with pytest.raises(InputError, match="^scene: must be a scene file, the name"):
            call(wrong)
    with pytest.raises(InputError, match="^capture: must be the path of a capture, got"):
        wiforce.read([wrong] if isinstance(wrong, list) else wrong, "demo")
    with pytest.raises(InputError, match="^sensor: must be the name of a shipped sensor"):
        wiforce.load_sensor(wrong)


def test_input_error_from_another_process_is_equal():
    received = pickle.loads(pickle.dumps(InputError("reference_s", "must be positive", -1)))
    assert (
        isinstance(received, InputError)
        and str(received) == "reference_s: must be positive, got -1"
    )
