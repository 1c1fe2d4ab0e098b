# SPDX-License-Identifier: GPL-3.0-or-later
"""How times grow along each axis: exponents, and scenes of the rows.

No speed is asserted here: that is what the benchmark is for.
"""

import json
import re
from dataclasses import asdict

import pytest
from command_runs import run_command
from gnuradio.wiforce.planning.plan import plan
from wiforce_app.bench import read
from wiforce_app.bench.read import AXES, growth, scaling_of, scene_of

SMALL = [setting for axis in ("sensors", "snapshots") for setting in AXES[axis]]


def row(setting, start_s=0.5, samples_ms=10.0, group_us=700.0, groups_ms=20.0):
    return {
        "setting": asdict(setting), "value": setting.value, "subcarriers": 62, "tones": 24,
        "plan_s": 0.1, "start_s": start_s, "samples_ms": samples_ms, "group_us": group_us,
        "groups_ms": groups_ms, "real_time": 50.0,
    }  # fmt: skip


@pytest.fixture
def measured(monkeypatch):
    """Rows with known exponents instead of those of this machine."""
    monkeypatch.setattr(
        read,
        "_scaling_row",
        lambda s, folder: row(s, samples_ms=3 * s.value**0.5, group_us=40 * s.value**1.5),
    )


def test_growth_of_powers_gives_their_exponents():
    """The exponents are what decides whether a larger set-up can be read at all."""
    rows = [row(s, samples_ms=s.value, group_us=5 * s.value**2) for s in AXES["sensors"]]
    # A part that does not grow hides the growth of the rest, except at the end.
    rows = [{**r, "start_s": 1 + 0.01 * r["value"] ** 3} for r in rows]
    found = {each["quantity"]: each for each in growth(rows)}
    assert found["samples_ms"]["exponent"] == found["samples_ms"]["at_end"] == 1.0
    assert found["group_us"]["exponent"] == 2.0 and found["groups_ms"]["exponent"] == 0.0
    assert 1 < found["start_s"]["exponent"] < 2 < found["start_s"]["at_end"] < 3


@pytest.mark.parametrize("axis", AXES)
def test_rows_change_only_their_axis_and_can_be_planned(axis):
    """A row that is refused after minutes of measuring would cost the whole run."""
    values = [s.value for s in AXES[axis]]
    assert values == sorted(set(values)) and len(values) == 5
    for setting in (AXES[axis][0], AXES[axis][-1]):
        scene = scene_of(setting)
        settings = plan(scene)
        assert len(settings.clocks) == setting.sensors
        assert settings.group_length == setting.snapshots
        # Whole periods, frames and groups in the piece that is repeated.
        assert all((3.6 * hz) % 1 == pytest.approx(0, abs=1e-6) for hz in settings.clocks_hz)
        assert 45_000_000 % (setting.frame_length * setting.snapshots) == 0


def test_command_scaling_prints_and_draws_rows(measured, tmp_path):
    """The exponents are what decides whether a larger set-up can be read at all."""
    command = ["bench", "read", "--scaling", "--axis", "sensors"]
    done = run_command(*command, "--plot", tmp_path / "scaling.png")
    assert (done.returncode, done.stderr) == (0, "")
    assert " cores, NumPy " in done.stdout
    assert "| sensors | groups (us/group) | 1.50 | 1.50 |" in re.sub(" +", " ", done.stdout)
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    both = [*command, "--axis", "snapshots", "--json"]
    result = json.loads(run_command(*both).stdout)
    assert [r["setting"] for r in result["rows"]] == [asdict(s) for s in SMALL]


@pytest.mark.parametrize(
    "options", [["--scaling", "--seconds", "9"], ["--axis", "sensors"], ["--plot", "a.png"]]
)
def test_command_read_options_of_other_form_are_refused(options):
    """An option without effect would leave its user waiting for it."""
    done = run_command("bench", "read", *options)
    assert done.returncode == 2 and "apply with --scaling" in done.stderr


@pytest.mark.long
def test_scaling_measures_rows(tmp_path, monkeypatch):
    """The measurement itself, for two lengths of the groups."""
    monkeypatch.setitem(AXES, "snapshots", AXES["snapshots"][1:3])
    result = scaling_of(["snapshots"], tmp_path)
    assert [r["value"] for r in result["rows"]] == [250, 625]
    assert all(r[key] > 0 for r in result["rows"] for key in ("start_s", "samples_ms", "group_us"))
