# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that were lost without a trace: frame timing slips, and readings go on."""

import copy
import shutil

import numpy as np
import pytest
from gnuradio import wiforce
from long_cases import cases
from press_capture import SCENE

RATE_HZ = 12.5e6


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """A press of 4 N from 0.8 s on, behind a reference of 0.5 s."""
    return press_of(tmp_path_factory)


@pytest.fixture(scope="module")
def press_of_two(tmp_path_factory):
    """The same, received by two antennas of a receiver with its own clock."""
    return press_of(tmp_path_factory, reader_clock="free", receive_antennas=2)


def press_of(tmp_path_factory, **environment):
    scene = copy.deepcopy(SCENE)
    scene["environment"] = {**scene.get("environment", {}), **environment}
    scene["reference_s"] = 0.5
    scene["simulation"]["duration_s"] = 1.4
    scene["simulation"]["presses"][0]["start_s"] = 0.8
    name = tmp_path_factory.mktemp("slip") / "press"
    wiforce.simulate(scene, name)
    return name


def slip(capture, name, at_s, lost):
    """Write a capture without some samples, or with more of them."""
    codes = np.fromfile(f"{capture}.sigmf-data", "<i2").reshape(-1, 2)
    at = int(at_s * RATE_HZ)
    if lost > 0:
        codes = np.delete(codes, slice(at, at + lost), axis=0)
    else:
        codes = np.insert(codes, [at] * -lost, codes[at], axis=0)
    codes.tofile(f"{name}.sigmf-data")
    shutil.copy(f"{capture}.sigmf-meta", f"{name}.sigmf-meta")


@pytest.mark.parametrize(
    ("at_s", "lost"),
    cases(
        *((0.1, 1), (0.4, 17), (0.25, -1), (0.02, -300)),
        long=((0.02, 300), (0.25, 1), (0.25, 300), (0.1, 2000), (0.45, -2), (0.25, -2500)),
    ),
)
def test_samples_lost_within_the_reference_cost_their_groups_only(press, tmp_path, at_s, lost):
    """The reference continues behind a slip: a single sample flagged the whole recording.

    Less than none are lost where some are inserted, which looks like a loss of most of a frame.
    """
    slip(press, tmp_path / "a", at_s, lost)
    readings = wiforce.read(tmp_path / "a")
    # A slip is found after 1072 frames at most, 62 ms, and groups last 36 ms.
    assert 1 <= readings["flags"].str.contains("gap").sum() <= 4
    whole = wiforce.read(press)
    steady = (whole["flags"] == "") & (whole["time_s"] > 0.55)
    found = readings.set_index("group").loc[whole.loc[steady, "group"]]
    assert (found["flags"] == "").mean() > 0.85
    touched = found[found["touch"] == 1]
    assert len(touched) > 5 and (np.abs(touched["force_n"] - 4.0) < 0.2).all()


@pytest.mark.parametrize(
    ("lost", "antennas"), cases((-1, (1, 2)), long=((300, (1, 2)), (-300, (1, 2)), (1, (1,))))
)
def test_samples_lost_at_two_antennas_cost_their_groups_only(
    press_of_two, tmp_path, lost, antennas
):
    """Frames that lay elsewhere entered the ratio, and the reference was that of noise."""
    for antenna, suffix in ((1, ""), (2, ".antenna2")):
        lost_here = lost if antenna in antennas else 0
        slip(f"{press_of_two}{suffix}", f"{tmp_path / 'a'}{suffix}", 0.25, lost_here)
    readings, whole = wiforce.read(tmp_path / "a"), wiforce.read(press_of_two)
    assert 1 <= readings["flags"].str.contains("gap").sum() <= 4
    steady = (whole["flags"] == "") & (whole["time_s"] > 0.55)
    found = readings.set_index("group").loc[whole.loc[steady, "group"]]
    assert (found["flags"] == "").mean() > 0.85
    change = found["force_n"].to_numpy() - whole.loc[steady, "force_n"].to_numpy()
    assert np.isfinite(change).sum() > 5 and np.nanmax(np.abs(change)) < 0.2
