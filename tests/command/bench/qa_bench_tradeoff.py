# SPDX-License-Identifier: GPL-3.0-or-later
"""Run time against error: the same signal under many settings, put in order."""

import json
import re

import pytest
from command_runs import run_command
from gnuradio import gr
from wiforce_app.bench import tradeoff
from wiforce_app.bench.tradeoff import beat_the_plan

# A fifth of the usual sample rate.
SHORT = """\
radio: {sample_rate_hz: 2.5e+6}
sounding: {frame_length: 320}
phase_group: {snapshots: 125}
sensors: [{name: arm, model: line-900mhz-calibrated, clock_hz: 400}]
reference_s: 0.3
simulation:
  truth_model: line-900mhz
  duration_s: 0.9
  seed: 3
  snr_db: 20
  static_clutter_db: 50
  presses:
    - {sensor: arm, start_s: 0.35, rise_s: 0.02, hold_s: 0.48, force_n: 4.0, location_mm: 45.0}
"""


def point(setting, cpu, phase, length=625):
    return {
        "setting": setting, "cpu_s_per_s": cpu, "phase_deg": phase, "group_length": length,
    }  # fmt: skip


def test_a_longer_group_is_no_better_by_its_lower_rate_alone():
    points = [point("plan", 1.0, 1.0), point("long", 0.5, 0.72, 1250), point("best", 0.7, 0.7)]
    assert beat_the_plan(points) == ["best"]


@pytest.fixture
def few_settings(monkeypatch):
    """One setting of each kind."""
    monkeypatch.setattr(tradeoff, "_GROUP_LENGTHS", (250,))
    monkeypatch.setattr(tradeoff, "HARMONICS", (12,))
    monkeypatch.setattr(tradeoff, "_CLUTTER_HZ", (250.0,))
    before = gr.logging().default_level()
    yield
    gr.logging().set_default_level(before)


def test_all_settings_read_the_same_signal(few_settings, tmp_path):
    (tmp_path / "short.yaml").write_text(SHORT)
    words = "bench tradeoff short.yaml --json".split()
    done = run_command(*words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    (result,) = json.loads(done.stdout)["scenes"]
    by_name = {p["setting"]: p for p in result["points"]}
    plan = by_name["plan"]
    assert plan["read"] > 20 and plan["phase_deg"] < 3 * plan["bound_deg"]
    for p in result["points"]:
        assert p["cpu_s_per_s"] == pytest.approx(p["samples_s_per_s"] + p["groups_s_per_s"])
    # the same samples by another way are the same readings
    for same in ("file-fc32", "stream-sc16", "stream-fc32", "block by block"):
        assert by_name[same]["phase_deg"] == pytest.approx(plan["phase_deg"], abs=1e-3)
    assert by_name["paper"]["phase_deg"] > 3 * plan["phase_deg"]
    changed = {"N_g 250", "clutter band 250 Hz", "sideband", "channel first"}
    assert changed | {"every second subcarrier"} <= by_name.keys()
    assert "| short | plan |" in re.sub(" +", " ", tradeoff.points_table([result]))
