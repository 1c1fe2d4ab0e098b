# SPDX-License-Identifier: GPL-3.0-or-later
"""What a survey has found, as the commands show it."""

import json
import shutil

import numpy as np
import pytest
import yaml
from command_runs import refused, run_command, succeeded
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.planning.findings import measure_tags
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from wiforce_app.plan.check import Findings, advice_on

SCENE = {
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 1040}],
    "reference_s": 0.4,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 0.6,
        "seed": 9,
        "snr_db": 10,
        "static_clutter_db": 50,
        "clock_offset_ppm": 30,
    },
}
ROOM = {
    "other_tags": [{"clock_hz": 1730, "clock_offset_ppm": -35, "level_db": -5, "delay_s": 2e-8}],
    "lamps": {"mains_hz": 50, "level_db": 5},
}


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """A quiet room, and one with a tag that is not listed and lamps."""
    folder = tmp_path_factory.mktemp("rooms")
    for name, effects in (("quiet", {}), ("busy", ROOM)):
        scene = {**SCENE, "simulation": {**SCENE["simulation"], **effects}}
        simulate(load_scene(scene), folder / name)
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(scene))
    return folder


@pytest.fixture(scope="module")
def busy(captures):
    done = run_command("survey", captures / "busy", "--json", "--plot", captures / "busy.png")
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def test_survey_json_lists_everything_in_the_room(busy):
    """A program that reads this must find the same keys in every room."""
    by_kind = {finding["kind"]: finding for finding in busy["findings"]}
    assert set(by_kind) == {"tag", "lamps"}
    keys = {"name", "kind", "frequency_hz", "level_db", "meaning", "handling", "matters"}
    assert all(keys <= set(finding) for finding in busy["findings"])
    assert by_kind["tag"]["frequency_hz"] == pytest.approx(1730 * (1 - 35e-6), abs=0.1)
    assert by_kind["lamps"]["frequency_hz"] == 50
    assert by_kind["lamps"]["level_db"] == pytest.approx(5, abs=1)
    assert busy["static_db"] == pytest.approx(50, abs=1)
    assert busy["noise_floor_db"] == pytest.approx(-10, abs=1)
    assert busy["level_reference"] == "line 1 of 'arm'"
    (arm,) = busy["sensors"]
    assert arm["clock_offset_ppm"] == pytest.approx(30, abs=2)


def test_tag_lost_in_noise_is_unknown_in_json_and_text():
    """JSON has no number for an SNR that was not measured, and other programs refuse NaN."""
    groups = Groups(np.arange(3))
    groups.locked = np.ones((3, 1), bool)
    groups.clock_offset_ppm = np.full((3, 1), 12.0)
    groups.snr_db = np.tile([np.nan, 4.71], (3, 1))
    groups.phase_std_deg = np.tile([np.inf, 0.41], (3, 1))
    (sensor,) = measure_tags(plan(load_scene(SCENE)), groups)
    assert (sensor.snr_db, sensor.phase_error_deg) == ([None, 4.71], [None, 0.41])
    assert "SNR unknown and 4.7 dB" in str(sensor)
    found = Findings("a device", {}, {"peak_dbfs": -6.0, "clipped": 0.0, "dc_dbfs": -90.0})
    found.sensors = [sensor]
    (advice,) = advice_on(found, load_scene(SCENE))
    assert "expected phase error is unknown" in advice


def test_survey_text_names_findings_and_their_handling(captures, busy):
    done = succeeded("survey", captures / "busy")
    for finding in busy["findings"]:
        assert finding["name"] in done.stdout and finding["handling"] in done.stdout
    for change in busy["changes"]:
        assert f"needed: {change}" in done.stdout
    assert (captures / "busy.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_survey_of_quiet_room_finds_nothing(captures):
    done = succeeded("survey", captures / "quiet")
    assert "found nothing besides the tags of the scene" in done.stdout
    assert done.stdout.count("skipped: ") == 3 and "needed: " not in done.stdout


@pytest.mark.parametrize("room, lines", [("quiet", 0), ("busy", 2)])
def test_read_reports_only_findings_that_matter(captures, room, lines):
    """Whoever reads must learn of a room that changes the plan, and of nothing else."""
    done = succeeded("read", captures / room, "-o", captures / f"{room}.csv")
    said = [line for line in done.stderr.splitlines() if "room: " in line]
    assert len(said) == lines, done.stderr
    assert not said or any("tag with a clock of 1729.9" in line for line in said)


def test_plan_of_capture_states_what_its_room_adds(captures, busy):
    done = run_command("plan", captures / "busy.yaml", "--capture", captures / "busy", "--json")
    report = json.loads(done.stdout)
    found = report["room"]
    assert found["findings"] == busy["findings"] and found["changes"] == busy["changes"]
    assert found["settings"]["tones"] > report["settings"]["tones"]
    assert any("adds separation of tags" in change for change in found["changes"])
    text = run_command("plan", captures / "quiet.yaml", "--capture", captures / "quiet").stdout
    assert "room of the capture" in text and "skipped: separation of tags" in text


def test_survey_and_plan_of_raw_samples_find_what_those_of_the_capture_do(captures, busy):
    raw, scene = ["--datatype", "ci16_le"], captures / "busy.yaml"
    data = shutil.copy(captures / "busy.sigmf-data", captures / "raw.bin")
    with open(data, "ab") as file:
        file.write(b"\0")
    done = run_command("survey", data, "--scene", scene, *raw, "--json")
    assert json.loads(done.stdout)["findings"] == busy["findings"], done.stderr
    assert "raw.bin: ends within a sample" in done.stderr
    done = run_command("plan", scene, "--capture", data, *raw, "--json")
    assert json.loads(done.stdout)["room"]["findings"] == busy["findings"], done.stderr
    assert "raw.bin: ends within a sample" in done.stderr
    assert "give --capture as well" in refused("plan", scene, *raw)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["missing"], "missing"),
        (["quiet", "--plot", "picture.txt"], ".png, .pdf or .svg"),
        (["quiet", "--scene", "nowhere"], "nowhere"),
        (["short"], "needs 0.1 s of untouched reference"),
    ],
)
def test_survey_bad_input_gives_one_line_and_status_2(captures, monkeypatch, arguments, message):
    monkeypatch.chdir(captures)
    if arguments == ["short"]:
        simulate(load_scene({**SCENE, "reference_s": 0.08}), captures / "short")
    assert message in refused("survey", *arguments)
