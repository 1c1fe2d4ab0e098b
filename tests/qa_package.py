# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the package: blocks, what their parameters are made with, and the rules on those."""

import pickle
import subprocess
import sys

import pytest
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene, shipped_scenes


def test_a_name_means_the_block_even_after_its_file_was_imported_for_something_else():
    """Each in a fresh interpreter: the import system binds a file's module to the same name."""
    code = (
        "from gnuradio import wiforce\n"
        "wiforce.tone_weights, wiforce.reader, wiforce.force_inversion\n"
        "for name in ('end_separation', 'reader', 'force_inversion', 'conjugate_difference'):\n"
        "    for _ in range(2):\n"
        "        assert isinstance(getattr(wiforce, name), type), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_tone_count_is_the_number_of_rows_of_its_weights():
    for clocks in ([1000.0], [1000.0, 1400.0], [700.0]):
        assert wiforce.tone_count(clocks) == len(wiforce.tone_weights(clocks))


@pytest.mark.parametrize("estimator", ["harmonic", "paper", "sideband"])
def test_the_same_settings_go_to_the_separation_and_to_all_that_is_before_it(estimator):
    settings = {"clocks_hz": [1000.0, 1400.0], "group_length": 250, "estimator": estimator}
    separation = wiforce.end_separation(**settings)
    rows = wiforce.tone_count(**settings)
    assert wiforce.tone_weights(**settings).shape == (rows, 250)
    assert wiforce.tone_derotation(**settings).shape == (rows, 64)
    assert separation.input_signature().sizeof_stream_item(0) == 8 * 64 * rows
    with pytest.raises(InputError, match="estimator"):
        wiforce.tone_count([1000.0], estimator="none")


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_had_by_name(name):
    assert load_scene(name).path.stem == name
    assert wiforce.is_scene(name)


def test_an_unknown_scene_name_is_refused_with_the_names_there_are():
    with pytest.raises(InputError, match="scene: must be a .yaml file or one of .*demo, .*'dome'"):
        load_scene("dome")


def test_rules_say_no_to_what_the_constructors_refuse(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("sensors: [{name: arm, model: nowhere}]\n")
    for scene in ("missing.yaml", "dome", broken, 3, {}):
        assert not wiforce.is_scene(scene)
    for model in ("missing.yaml", "wiforce-800mhz", 3):
        assert not wiforce.is_sensor(model)
    assert wiforce.is_sensor("line-900mhz")
    good = ([1000.0], 625, 720, 12.5e6, 0.0, 8)
    assert wiforce.is_tone_design(*good)
    for index, wrong in enumerate(([3000.0], 0, -720, 0.0, 1000.0, 3)):
        assert not wiforce.is_tone_design(*good[:index], wrong, *good[index + 1 :])


def test_an_error_told_by_another_process_is_the_same():
    told = pickle.loads(pickle.dumps(InputError("reference_s", "must be positive", -1)))
    assert isinstance(told, InputError) and str(told) == "reference_s: must be positive, got -1"
