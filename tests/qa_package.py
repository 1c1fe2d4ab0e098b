# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the package: blocks, what their parameters are made with, and the rules on those."""

import pickle
import subprocess
import sys

import pytest
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene, shipped_scenes


def test_package_name_means_the_block_after_its_module_was_imported():
    """Each in a fresh interpreter: the import system binds a file's module to the same name."""
    code = (
        "from gnuradio import wiforce\n"
        "wiforce.plan, wiforce.reader, wiforce.force_inversion\n"
        "for name in ('end_separation', 'reader', 'force_inversion', 'conjugate_difference'):\n"
        "    for _ in range(2):\n"
        "        assert isinstance(getattr(wiforce, name), type), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("estimator", ["harmonic", "paper", "sideband"])
@pytest.mark.parametrize("clocks_hz", [[1000.0], [1000.0, 1400.0], [700.0]], ids=str)
def test_plan_sets_the_sizes_of_the_separation_and_the_blocks_before(estimator, clocks_hz):
    sensors = [
        {"name": f"s{i}", "model": "line-900mhz", "clock_hz": f} for i, f in enumerate(clocks_hz)
    ]
    plan = wiforce.plan({"sensors": sensors}, snapshots=250, estimator=estimator)
    rows = len(plan.table.tones)
    assert plan.estimator == estimator
    assert plan.table.weights.shape == (rows, 250)
    assert plan.table.derotation(plan.waveform.sample_rate_hz).shape == (rows, 64)
    separation = wiforce.end_separation(plan)
    assert separation.input_signature().sizeof_stream_item(0) == 8 * 64 * rows
    assert separation.output_signature().sizeof_stream_item(0) == 8 * 64 * 2 * len(clocks_hz)


def test_plan_with_an_unknown_estimator_is_refused():
    with pytest.raises(InputError, match="estimator"):
        wiforce.plan("demo", estimator="none")


@pytest.mark.parametrize("name", shipped_scenes())
def test_scene_shipped_is_available_by_name(name):
    assert load_scene(name).path.stem == name
    assert wiforce.is_scene(name)


def test_scene_unknown_name_is_refused_with_the_nearest_one():
    with pytest.raises(InputError, match="scene: must be .* mean 'demo'.* got 'dome'"):
        load_scene("dome")


def test_rules_refuse_what_the_constructors_refuse(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("sensors: [{name: arm, model: nowhere}]\n")
    for scene in ("missing.yaml", "dome", broken, 3, {}):
        assert not wiforce.is_scene(scene)
    for model in ("missing.yaml", "wiforce-800mhz", 3):
        assert not wiforce.is_sensor(model)
    assert wiforce.is_sensor("line-900mhz")
    sensor = {"name": "arm", "model": "line-900mhz"}
    assert wiforce.is_scene({"sensors": [sensor]})
    for wrong in (
        {"sensors": [sensor | {"clock_hz": 3000.0}]},
        {"phase_group": {"snapshots": 0}},
        {"phase_group": {"snapshots": 12}},
        {"sounding": {"frame_length": -720}},
        {"radio": {"sample_rate_hz": 0.0}},
        {"environment": {"moving_clutter_hz": 1000.0}},
    ):
        assert not wiforce.is_scene({"sensors": [sensor]} | wrong)


def test_input_error_from_another_process_is_equal():
    received = pickle.loads(pickle.dumps(InputError("reference_s", "must be positive", -1)))
    assert (
        isinstance(received, InputError)
        and str(received) == "reference_s: must be positive, got -1"
    )
