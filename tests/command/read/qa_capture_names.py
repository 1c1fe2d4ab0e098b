# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce simulate` and recordings: which names they take, what they replace and leave."""

import signal
from pathlib import Path

import pytest
import yaml
from command_runs import ended_by, refused, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene, simulation_warnings
from long_cases import cases

SENSOR = {"name": "arm", "model": "line-900mhz-calibrated"}
SHORT = {"sensors": [SENSOR], "simulation": {"truth_model": "line-900mhz", "duration_s": 0.04}}
SUFFIXES = (".sigmf-data", ".sigmf-meta", ".truth.csv")


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(SHORT))
    return path


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_simulate_existing_file_is_replaced_with_force_only(scene, tmp_path, suffix):
    """A measured capture of the same name would be lost."""
    precious = tmp_path / f"press{suffix}"
    precious.write_text("precious")
    said = refused("simulate", scene, tmp_path / "press")
    assert f"press{suffix}: exists already; --force replaces it" in said
    assert precious.read_text() == "precious"
    assert names_in(tmp_path) == [precious.name, "scene.yaml"]
    succeeded("simulate", scene, tmp_path / "press.sigmf-meta", "--force")
    assert names_in(tmp_path) == [*(f"press{each}" for each in SUFFIXES), "scene.yaml"]


def test_simulate_function_replaces_files_only_when_asked_to(scene, tmp_path):
    (tmp_path / "press.sigmf-data").write_text("precious")
    with pytest.raises(InputError, match=r"exists already; overwrite=True replaces it$"):
        wiforce.simulate(scene, tmp_path / "press")
    wiforce.simulate(scene, tmp_path / "press", overwrite=True)


@pytest.mark.parametrize(
    "number, status", cases((signal.SIGINT, 130), long=((signal.SIGTERM, 143),))
)
def test_simulate_ended_by_signal_leaves_no_file(tmp_path, number, status):
    """A minute of samples in a hidden folder fills the disk, and nobody knows whose it is."""
    content = {**SHORT, "simulation": {"truth_model": "line-900mhz", "duration_s": 60.0}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))

    def begun():
        return any(path.stat().st_size for path in tmp_path.glob(".simulate-*/*"))

    command = "simulate", tmp_path / "scene.yaml", tmp_path / "long"
    ended, said = ended_by(number, begun, *command)
    word = "terminated" if number == signal.SIGTERM else "interrupted"
    assert (ended, said.strip()) == (status, f"gr-wiforce: {word}")
    assert names_in(tmp_path) == ["scene.yaml"]


@pytest.mark.parametrize("name", ["", ".", "..", "runs/", "/dev/null", "a\nb"])
def test_capture_name_that_no_file_can_have_is_refused(scene, tmp_path, name):
    """`live --record ""` recorded nothing and ended with success."""
    (tmp_path / "runs").mkdir()
    for command in (
        ["simulate", scene, name],
        ["live", "--scene", scene, "--args", "addr=127.0.0.1", "--record", name],
    ):
        assert "must be the name of a capture" in refused(*command, cwd=tmp_path)
    with pytest.raises(InputError, match="must be the name of a capture"):
        wiforce.sigmf_recorder(name)
    assert names_in(tmp_path) == ["runs", "scene.yaml"]
    assert not Path("/dev/null.sigmf-data").exists()


def test_recording_name_with_suffix_can_be_opened_by_it(tmp_path):
    """`--record x.sigmf-data` wrote x.sigmf-data.sigmf-data, which `read x.sigmf-data` missed."""
    (tmp_path / "x.sigmf-data").write_bytes(b"")
    with pytest.raises(InputError, match="x.sigmf-data: exists already"):
        wiforce.sigmf_recorder(tmp_path / "x.sigmf-data")


def test_simulation_warnings_name_sensors_read_by_the_model_that_is_pressed(scene, tmp_path):
    """Such a simulation shows no calibration error, and promises too much."""
    assert simulation_warnings(load_scene(scene)) == []
    same = {**SHORT, "sensors": [{"name": "arm", "model": "line-900mhz"}]}
    (found,) = simulation_warnings(load_scene(same))
    assert found.startswith("sensor 'arm': the model that is pressed and the one that reads it")
    scene.write_text(yaml.safe_dump(same))
    done = succeeded("simulate", scene, tmp_path / "press")
    assert f"warning: {found}" in done.stderr
