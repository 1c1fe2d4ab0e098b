# SPDX-License-Identifier: GPL-3.0-or-later
"""The command that finds the switches' off state from a capture with presses."""

import pytest
import yaml
from command_runs import run_command
from gnuradio.wiforce.scene import load_scene

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
    # A fifth of the usual rate takes a fifth of the time.
    rates = {
        "radio": {"sample_rate_hz": 2.5e6},
        "sounding": {"frame_length": 400},
        "phase_group": {"snapshots": 200},
    }
    scene = {"sensors": [sensor], "reference_s": 0.3, "simulation": simulation, **rates}
    path.write_text(yaml.safe_dump(scene))


@pytest.mark.parametrize("pressed", [True, False])
def test_the_off_state_is_found_from_presses_or_refused_without(tmp_path, pressed):
    """The reader's scene does not know it; forces and locations are not given either."""
    presses = [p | {"location_mm": mm} for p, mm in zip(PRESSES, (25.0, 60.0), strict=True)]
    write_scene(tmp_path / "true.yaml", OFF, presses if pressed else [])
    write_scene(tmp_path / "known.yaml", [0.0, 0.0], [])
    assert run_command("simulate", tmp_path / "true.yaml", tmp_path / "air").returncode == 0
    done = run_command("off-reflection", tmp_path / "air", "--scene", tmp_path / "known.yaml")
    if not pressed:
        assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1
        assert "sensor 'arm', end 1" in done.stderr and "needs presses" in done.stderr
        return
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("# arm\n")
    # What is printed is what a scene takes.
    found = yaml.safe_load(done.stdout)
    assert found["off_reflection"] == [pytest.approx(pair, abs=0.01) for pair in OFF]
    scene = yaml.safe_load((tmp_path / "known.yaml").read_text())
    scene["sensors"][0] |= found
    assert 0 < load_scene(scene).sensors[0].off_reflection_std < 0.01


def test_the_scene_of_the_capture_is_taken_where_none_is_named(tmp_path):
    presses = [p | {"location_mm": mm} for p, mm in zip(PRESSES, (25.0, 60.0), strict=True)]
    write_scene(tmp_path / "true.yaml", OFF, presses)
    assert run_command("simulate", tmp_path / "true.yaml", tmp_path / "air").returncode == 0
    done = run_command("off-reflection", tmp_path / "air")
    assert done.returncode == 0 and "off_reflection_std" in done.stdout, done.stderr
