# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures of a surface that somebody else made: strips, skin and samples share no code with us.

Everything a user does is done: strips are calibrated from VNA tables, the skin from taps that are
read from a capture, and presses at other points are read from another one.
"""

from dataclasses import replace

import numpy as np
import pytest
import second_simulator as other
import surface_presses as made
import yaml
from command_runs import rows_of, succeeded
from rooms.effects import OtherSensors
from rooms.rooms import Capture, Room
from skin_law import ALONG_MM, strip_loads

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]
FIRST_S, RISE_S, HOLD_S, EACH_S = 0.7, 0.02, 0.15, 0.3


def tags_under(presses, lost=None):
    """The four tags while the skin is pressed: rows of force, x, y, one after the other."""
    loads = strip_loads(presses[:, 0], presses[:, 2])
    tags = []
    for i, (name, clock_hz) in enumerate(zip(made.NAMES, made.CLOCKS_HZ, strict=True)):
        own = tuple(
            (FIRST_S + EACH_S * n, RISE_S, HOLD_S, load, load, press[1] - ALONG_MM[i])
            for n, (press, load) in enumerate(
                zip(presses.tolist(), loads[:, i].tolist(), strict=True)
            )
        )
        port_deg = (37.0 - 20 * i, -81.0 + 30 * i)
        line = other.Line(width_mm=2.1 + 0.05 * i, tilt=0.62 - 0.02 * i)
        off = {"offset_ppm": 25.0 - 20 * i, "level_db": -140.0 if i == lost else -float(i)}
        tags.append(other.Tag(name, clock_hz, presses=own, port_deg=port_deg, line=line, **off))
    return tuple(tags)


def write_capture(folder, name, presses, seed, lost=None):
    duration_s = FIRST_S + EACH_S * len(presses)
    first, *others = tags = tags_under(presses, lost)
    room = Room((OtherSensors(tuple(others)),), duration_s=duration_s)
    other.write_capture(Capture(room, seed, first).blocks(), folder / name)
    return tags


def held(n):
    """When press n is held, without its first and last group."""
    start = FIRST_S + EACH_S * n + RISE_S
    return start, start + HOLD_S


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A calibrated surface."""
    folder = tmp_path_factory.mktemp("captures")
    taps = made.known_presses(along=(28.0, 52.0))
    for i, tag in enumerate(write_capture(folder, "taps", taps, 21)):
        vna = replace(tag, presses=())
        other.write_vna(vna, folder / f"{tag.name}.csv", np.random.default_rng(i))
        succeeded("calibrate", f"{tag.name}.csv", "-o", f"{tag.name}.yaml", cwd=folder)
    (folder / "bare.yaml").write_text(yaml.safe_dump(made.scene("{}.yaml")))
    made.write_taps(folder / "taps.csv", [[*held(n), *tap] for n, tap in enumerate(taps.tolist())])
    read(folder, "bare.yaml", "taps")
    done = succeeded(
        *("calibrate", "taps.csv", "--surface", "bare.yaml", "--readings", "taps-read.csv"),
        *("-o", "skin.yaml"),
        cwd=folder,
    )
    print(done.stdout)
    scene = made.scene("{}.yaml", spreading_file="skin.yaml")
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))
    return folder


def read(folder, scene, name):
    succeeded("read", name, "--scene", scene, "-o", f"{name}-read.csv", cwd=folder)
    return [row for row in rows_of(folder / f"{name}-read.csv") if row["sensor"] == "skin"]


@pytest.fixture(scope="module")
def presses():
    """Points that were not calibrated."""
    return np.random.default_rng(31).uniform([4, 25, 0], [8, 55, 36], (30, 3))


def errors(rows, presses):
    """Errors, standard deviations and flags in the groups in which a press was held."""
    pairs = []
    for n, press in enumerate(presses):
        start, end = held(n)
        for row in rows:
            # Whole groups of 36 ms inside the time in which the force is constant.
            if start <= float(row["time_s"]) - 0.018 and float(row["time_s"]) + 0.018 <= end:
                assert row["touch"] == "1", row
                pairs.append((row, press))

    def numbers(*names):
        return np.array([[float(row[name]) for name in names] for row, _ in pairs])

    true = np.array([press for _, press in pairs])
    error = numbers("force_n", "location_mm", "y_mm") - true
    std = numbers("force_std_n", "location_std_mm", "y_std_mm")
    return error, std, true[:, 0], [row["flags"] for row, _ in pairs]


def report(error, std, force):
    inside = (np.abs(error) < 2 * std).mean(axis=0)
    relative = np.abs(error[:, 0]) / force
    print(
        f"force {100 * np.median(relative):.2f} % (95 %: {100 * np.quantile(relative, 0.95):.2f}),",
        f"x {np.median(np.abs(error[:, 1])):.3f}, y {np.median(np.abs(error[:, 2])):.3f} mm",
        f"(95 %: {np.quantile(np.abs(error[:, 1:]), 0.95, axis=0).round(3)}), inside {inside}",
    )
    return inside


def test_presses_at_new_points_are_within_five_percent_and_a_millimetre(folder, presses):
    write_capture(folder, "presses", presses, 22)
    error, std, force, flags = errors(read(folder, "scene.yaml", "presses"), presses)
    inside = report(error, std, force)
    assert len(error) >= 2 * len(presses)
    assert np.quantile(np.abs(error[:, 0]) / force, 0.95) < 0.05
    assert np.quantile(np.abs(error[:, 1:]), 0.95, axis=0).max() < 1.0
    assert inside.min() >= 0.9
    # Next to a rise, groups are transitions.
    assert sum(not words for words in flags) >= 0.7 * len(flags)


def test_a_strip_switched_off_is_flagged_and_errors_are_as_stated(folder, presses):
    write_capture(folder, "lost", presses, 23, lost=1)
    error, std, force, flags = errors(read(folder, "scene.yaml", "lost"), presses)
    inside = report(error, std, force)
    assert all("weak" in words.split() for words in flags)
    assert inside.min() >= 0.9
