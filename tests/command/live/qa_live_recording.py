# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings of live runs at the full rate: what they hold, and when readings came."""

import json

import pytest
from command_runs import run_command
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.scene import load_scene
from live_runs import (
    FRAMES,
    rows_of,
    run_session,
    scene_file,
)
from software_usrp import SoftwareUsrp

GROUP_S = 0.036


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A short recorded run with an overflow: scene, recording, readings and when they came."""
    folder = tmp_path_factory.mktemp("recorded")
    scene = scene_file(folder, [(0.7, 4.0, 4.0, 45.0)], reference_s=0.3)
    device = SoftwareUsrp(scene, faults=["+1.0 overflow 45000"])
    try:
        readings, _ = run_session("timed", scene, f"{device.args},{FRAMES}", folder / "run", 1.4)
    finally:
        device.stop()
    return scene, folder / "run", readings


@pytest.mark.long
def test_live_onset_reported_within_a_tenth_of_a_second(recorded):
    _, _, readings = recorded
    # The force rises from 0 to 4 N in 0.7 .. 0.8 s, and shorts the line from 0.9 N on. The group
    # in which that happens is flagged.
    onset_s = 0.7 + 0.1 * 0.9 / 4
    reported_s = next(row["came_s"] for row in readings if "transition" in row["flags"])
    assert 0.7 < reported_s <= onset_s + 0.1
    touched = next(row["came_s"] for row in readings if row["touch"] == 1)
    assert touched <= onset_s + 0.15


def test_live_recording_reads_as_the_live_run(recorded, tmp_path):
    scene, capture, live_rows = recorded
    output = tmp_path / "read.csv"
    run_command("read", capture, "--scene", scene, "-o", output).check_returncode()
    read = rows_of(output)
    # The recorder may be a few samples ahead of the reader when the run is stopped.
    assert 0 <= len(read) - len(live_rows) <= 1
    assert len(live_rows) >= 38
    for ours, theirs in zip(live_rows[:-1], read, strict=False):
        assert float(theirs["time_s"]) == pytest.approx(ours["time_s"], abs=1e-9)
        assert theirs["flags"] == ours["flags"] and theirs["touch"] == str(ours["touch"])
        for name in ("phase1_deg", "phase2_deg"):
            assert float(theirs[name]) == pytest.approx(ours[name], abs=1e-3)


def test_live_recording_metadata_names_device_gains_and_loss(recorded):
    scene, capture, _ = recorded
    opened = open_capture(capture)
    opened.check_against(load_scene(scene))
    assert len(opened.segments) == 2
    assert opened.span - opened.samples == 45000
    fields = json.loads(capture.with_name("run.sigmf-meta").read_text())["global"]
    assert "N210" in fields["core:hw"] and fields["core:datatype"] == "ci16_le"
    assert fields["wiforce:rx_gain_db"] == fields["wiforce:tx_gain_db"] == 15
    assert fields["wiforce:scene"]["sensors"][0]["name"] == "arm"
