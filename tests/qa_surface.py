# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces: force, x and y of presses on strips and between them, under a skin of another law."""

import numpy as np
import pytest
import surface_presses as made
import yaml
from command_runs import run_command
from gnuradio.wiforce.io.writers import open_writer
from gnuradio.wiforce.planning.plan import plan
from skin_law import other_loads


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene, taps at known points and their readings: what a user calibrates a skin with."""
    folder = tmp_path_factory.mktemp("surface")
    calibrate_in(folder, np.random.default_rng(5))
    return folder


def calibrate_in(folder, rng):
    (folder / "bare.yaml").write_text(yaml.safe_dump(made.scene()))
    taps = made.known_presses(rng)
    made.write_taps(folder / "taps.csv", taps)
    with open_writer(folder / "readings.csv") as writer:
        for reading in made.readings_of(plan(folder / "bare.yaml"), [[t] for t in taps], rng):
            writer.write(reading)
    done = run_command(
        *("calibrate", "taps.csv", "--surface", "bare.yaml", "--readings", "readings.csv"),
        *("-o", "skin.yaml"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    scene = made.scene(spreading_file="skin.yaml", presses=2)
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))


@pytest.fixture(scope="module")
def settings(folder):
    return plan(folder / "scene.yaml")


@pytest.fixture(scope="module")
def presses(long_run):
    """Presses anywhere on and between the strips: none was calibrated."""
    rng, count = np.random.default_rng(8), 1000 if long_run else 80
    return rng.uniform([4, 25, 0], [9, 55, 36], (count, 3))


def test_presses_anywhere_are_read_within_five_percent_and_a_millimetre(settings, presses):
    readings = made.readings_of(settings, presses[:, None].tolist(), np.random.default_rng(9))
    error, std, true = made.errors_of(made.of_surface(readings), presses)
    assert len(error) == len(presses)
    assert np.quantile(np.abs(error[:, 0]) / true[:, 0], 0.95) < 0.05
    assert np.quantile(np.abs(error[:, 1:]), 0.95, axis=0).max() < 1.0
    inside = (np.abs(error) < 2 * std).mean(axis=0)
    assert inside.min() >= 0.9, inside
    # Flags would hide the errors of readings that a user must not trust.
    clear = [r for r in made.of_surface(readings) if not r.flags]
    assert len(clear) >= 0.95 * len(presses)


@pytest.mark.long
def test_another_skin_is_read_within_the_stated_uncertainty(tmp_path, monkeypatch):
    """No figure of the reader may be that of one skin."""
    monkeypatch.setattr(made, "strip_loads", other_loads)
    calibrate_in(tmp_path, np.random.default_rng(6))
    rng = np.random.default_rng(16)
    presses = rng.uniform([4, 25, 0], [9, 55, 36], (500, 3))
    readings = made.readings_of(plan(tmp_path / "scene.yaml"), presses[:, None].tolist(), rng)
    error, std, _ = made.errors_of(made.of_surface(readings), presses)
    assert len(error) == len(presses)
    assert (np.abs(error) < 2 * std).mean(axis=0).min() >= 0.9
    # Nor may it hide errors behind large uncertainties.
    assert np.sqrt(np.mean((error / std) ** 2, axis=0)).min() > 0.5


@pytest.mark.parametrize("lost", [1])
def test_a_lost_strip_is_flagged_and_errors_stay_within_the_stated_uncertainty(
    settings, presses, lost
):
    readings = made.readings_of(
        settings, presses[:, None].tolist(), np.random.default_rng(10), lost
    )
    own = made.of_surface(readings)
    assert all("weak" in r.flags for r in own)
    error, std, _ = made.errors_of(own, presses)
    assert len(error) >= 0.98 * len(presses)
    inside = (np.abs(error) < 2 * std).mean(axis=0)
    assert inside.min() >= 0.9, inside
    # A press that only the lost strip would show is not known to be absent.
    assert all(r.touch is None for r in own if r.touch != 1)


def test_presses_outside_the_strips_are_flagged_or_within_their_uncertainty(settings):
    """Beyond the surface one strip is touched, as by a lighter press on it."""
    rng = np.random.default_rng(15)
    outside = rng.uniform([4, 25, 43], [14, 55, 50], (20, 3))
    outside[::2, 2] = 36 - outside[::2, 2]
    readings = made.readings_of(settings, outside[:, None].tolist(), rng)
    own = made.of_surface(readings)
    assert sum(r.touch == 1 for r in own) >= 10
    assert all("extrapolated" in r.flags for r in own if r.touch == 1)


def test_two_presses_far_apart_are_both_read(settings):
    both = [(6.0, 30.0, 0.0), (7.0, 50.0, 36.0)]
    readings = made.readings_of(settings, [both] * 4, np.random.default_rng(11))
    for name, press in zip(("skin-2", "skin"), both, strict=True):
        own = made.of_surface(readings, name)
        error, std, _ = made.errors_of(own, [press] * 4)
        assert len(error) == 4
        assert (np.abs(error) < np.maximum(3 * std, [0.3, 1.0, 1.0])).all(), name
        assert not any("inconsistent" in r.flags for r in own)


def test_two_presses_too_near_are_flagged_inconsistent(settings):
    both = [(6.0, 30.0, 10.0), (7.0, 50.0, 26.0)]
    readings = made.readings_of(settings, [both] * 4, np.random.default_rng(12))
    own = made.of_surface(readings)
    assert all("inconsistent" in r.flags for r in own if r.touch == 1)


def test_an_untouched_surface_has_a_row_without_a_press(settings):
    readings = made.readings_of(settings, [[]] * 5, np.random.default_rng(13))
    assert [(r.touch, r.force_n, r.y_mm) for r in made.of_surface(readings)] == [
        (0, None, None)
    ] * 5


def test_a_strip_that_runs_the_other_way_gives_the_same_x(folder):
    """Strips are often fed from alternating sides."""
    scene = made.scene(spreading_file=str(folder / "skin.yaml"))
    press, rng = [[(6.0, 33.0, 12.0)]] * 8, np.random.default_rng
    straight = made.of_surface(made.readings_of(plan(scene), press, rng(14)))
    # The same sensor mirrored: what is at 33 mm from port 1 of a strip along +x.
    for strip in scene["surface"]["strips"]:
        strip |= {"x_mm": 66.0, "direction": "-x"}
    turned = made.of_surface(made.readings_of(plan(scene), press, rng(14)))
    for one, other in zip(straight, turned, strict=True):
        assert abs((66.0 - one.location_mm) - other.location_mm) < 0.1
        assert abs(one.y_mm - other.y_mm) < 0.05


def test_readings_do_not_depend_on_the_law_of_a_scene_without_one(folder):
    """Strips stay as they are; a surface that is not calibrated has no rows."""
    readings = made.readings_of(
        plan(folder / "bare.yaml"), [[(6.0, 40.0, 12.0)]], np.random.default_rng(15)
    )
    assert {r.sensor for r in readings} == set(made.NAMES)


def test_a_stated_gaussian_is_read_with_its_own_error(presses):
    law = {"law": "gaussian", "share": 0.5, "width_mm": 9.0, "share_std": 0.12}
    scene = made.scene(spreading=law)
    readings = made.readings_of(plan(scene), presses[:60, None].tolist(), np.random.default_rng(9))
    error, std, _ = made.errors_of(made.of_surface(readings), presses[:60])
    assert (np.abs(error) < 2 * std).mean(axis=0).min() >= 0.9


BAD = {
    "surface.strips[1].sensor: must be the name of a sensor of the scene": {"strips": [
        {"sensor": "a", "y_mm": 0}, {"sensor": "nobody", "y_mm": 12}]},
    "surface.strips[1].sensor: must differ from that of surface.strips[0]": {"strips": [
        {"sensor": "a", "y_mm": 0}, {"sensor": "a", "y_mm": 12}]},
    "surface.strips: must be a list of 2 to 16 mappings": {"strips": [
        {"sensor": "a", "y_mm": 0}]},
    "surface.strips[1].y_mm: must lie 0.1 mm or more from": {"strips": [
        {"sensor": "a", "y_mm": 3}, {"sensor": "b", "y_mm": 3}]},
    "surface.strips[0].y_mm: must be a number": {"strips": [
        {"sensor": "a", "y_mm": float("nan")}, {"sensor": "b", "y_mm": 3}]},
    "surface.strips: must overlap along x": {"strips": [
        {"sensor": "a", "y_mm": 0}, {"sensor": "b", "y_mm": 9, "x_mm": 100}]},
    "surface.name: must differ from the name of every sensor": {"name": "b"},
    "surface.spreading.law: must be 'gaussian' or 'table'": {"spreading": {"law": "cosine"}},
    "surface.spreading.share: is missing": {"spreading": {"width_mm": 5}},
    "surface.spreading.distance_mm: must begin with 0 and rise": {"spreading": {
        "law": "table", "distance_mm": [0, 5, 4], "shares": [0.5, 0.2, 0]}},
    "surface.spreading.shares: must have as many numbers as distance_mm, 2": {"spreading": {
        "law": "table", "distance_mm": [0, 5], "shares": [0.5, 0.2, 0]}},
    "surface.spreading: must be a law of as many strips as the surface has, 4": {"spreading": {
        "law": "strips", "distance_mm": [0, 5], "strip_shares": [[0.5, 0.2], [0.5, 0.2]]}},
    "surface.spreading: must be a law of as many strips as the surface has, 4, got 3": {
        "spreading": {"share": 0.5, "width_mm": 9, "location_offsets_mm": [0.1, 0, 0]}},
    "surface.spreading.location_offsets_mm": {
        "spreading": {"share": 0.5, "width_mm": 9, "location_offsets_mm": [0.1, 0, 0, 101]}},
    "surface.spreading_file: nowhere.yaml: cannot be read (No such file or directory); leave": {
        "spreading_file": "nowhere.yaml"},
    "surface.spreading_file: must be left out": {
        "spreading": {"share": 0.5, "width_mm": 9}, "spreading_file": "x.yaml"},
}  # fmt: skip


@pytest.mark.parametrize("message", BAD)
def test_a_bad_surface_is_refused_in_one_line(message, tmp_path):
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(made.scene(**BAD[message])))
    done = run_command("plan", "bad.yaml", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and f"bad.yaml: {message}" in done.stderr, done.stderr


TAPS = "start_s,end_s,force_n,x_mm,y_mm\n"
BAD_TAPS = {
    "must have the columns start_s, end_s, force_n, x_mm, y_mm": "start_s,end_s,force_n\n1,2,3\n",
    "row 2: force_n: must be finite": TAPS + "1,2,nan,40,0\n",
    "row 2: y_mm: must be a number": TAPS + "1,2,5,40,\n",
    "row 2: force_n must be above 0": TAPS + "1,2,0,40,0\n",
    "row 2: end_s must be later than start_s": TAPS + "2,1,5,40,0\n",
    "must press strips 6 times or more": TAPS + "0.54,0.58,5,40,0\n",
    "no clear reading of a strip lies between start_s and": TAPS + "9000,9001,5,40,0\n",
    "has no rows": TAPS,
}  # fmt: skip


@pytest.mark.parametrize("message", BAD_TAPS)
def test_bad_taps_are_refused_in_one_line(message, folder):
    (folder / "bad.csv").write_text(BAD_TAPS[message])
    done = run_command(
        *("calibrate", "bad.csv", "--surface", "bare.yaml", "--readings", "readings.csv"),
        *("-o", "other.yaml"),
        cwd=folder,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "bad.csv" in done.stderr, done.stderr
    assert message in done.stderr, done.stderr
    assert not (folder / "other.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("taps.csv", "--surface", "bare.yaml"), "--readings: is missing"),
        (("taps.csv", "--surface", "demo", "--readings", "readings.csv"), "must be a scene with a"),
        (("taps.csv", "--readings", "readings.csv"), "--readings: is for --surface only"),
        (("taps.csv", "--surface", "bare.yaml", "--refine", "x"), "--refine: cannot be given"),
    ],
)
def test_bad_options_of_a_surface_calibration_are_refused(arguments, message, folder):
    done = run_command("calibrate", *arguments, "-o", "other.yaml", cwd=folder)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert message in done.stderr, done.stderr
