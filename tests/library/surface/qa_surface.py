# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces: force, x and y of presses on strips and between them, under a skin of another law."""

import numpy as np
import pytest
import surface_presses as made
import yaml
from command_runs import refused, run_command, succeeded
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.surface import skin_of
from gnuradio.wiforce.surface.calibration import SurfaceTaps, fit_spreading
from gnuradio.wiforce.surface.estimator import SurfaceEstimator
from gnuradio.wiforce.surface.skin import read_spreading
from skin_law import STRIPS_MM, strip_loads


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene, taps at known points and their readings: what a user calibrates a skin with."""
    folder = tmp_path_factory.mktemp("surface")
    calibrate_in(folder, np.random.default_rng(5))
    return folder


def calibrate_in(folder, rng):
    (folder / "bare.yaml").write_text(yaml.safe_dump(made.scene()))
    taps = made.known_presses()
    made.write_taps(folder / "taps.csv", made.timed(taps))
    with open_writer(folder / "readings.csv") as writer:
        for reading in made.readings_of(plan(folder / "bare.yaml"), [[t] for t in taps], rng):
            writer.write(reading)
    calibrate_again(folder, "taps.csv", "skin.yaml")
    scene = made.scene(spreading_file="skin.yaml", presses=2)
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))


def command_of(table, output, law="strips"):
    options = "--surface", "bare.yaml", "--readings", "readings.csv", "-o", output, "--law", law
    return "calibrate", table, *options


def calibrate_again(folder, *arguments):
    return succeeded(*command_of(*arguments), cwd=folder)


def refused_taps(folder, table):
    """The line that refuses a table, without a file of what it would have given."""
    line = refused(*command_of(table, "other.yaml"), cwd=folder)
    assert table in line and not (folder / "other.yaml").exists()
    return line


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


def test_a_lost_strip_is_flagged_and_errors_stay_within_the_stated_uncertainty(settings, presses):
    readings = made.readings_of(settings, presses[:, None].tolist(), np.random.default_rng(10), 1)
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


def test_two_presses_far_apart_are_both_read_and_near_ones_flagged(settings):
    both = [(6.0, 30.0, 0.0), (7.0, 50.0, 36.0)]
    readings = made.readings_of(settings, [both] * 4, np.random.default_rng(11))
    for name, press in zip(("skin-2", "skin"), both, strict=True):
        own = made.of_surface(readings, name)
        error, std, _ = made.errors_of(own, [press] * 4)
        assert len(error) == 4
        assert (np.abs(error) < np.maximum(3 * std, [0.3, 1.0, 1.0])).all(), name
        assert not any("inconsistent" in r.flags for r in own)
    near = [(6.0, 30.0, 10.0), (7.0, 50.0, 26.0)]
    own = made.of_surface(made.readings_of(settings, [near] * 4, np.random.default_rng(12)))
    assert all("inconsistent" in r.flags for r in own if r.touch == 1)


@pytest.mark.parametrize("law", ["strips", "table", "gaussian"])
def test_every_law_is_calibrated_by_the_command_and_accepted_by_its_scene(folder, law):
    """A user who follows the documentation would end with an error, or without a file."""
    done = calibrate_again(folder, "taps.csv", f"{law}.yaml", law)
    assert done.stderr == ""
    found = read_spreading(folder / f"{law}.yaml")
    assert found.law == law
    # Strips at the edges bear more; laws of one curve for all of them find the mean.
    true = np.mean([strip_loads(6.0, y)[i] / 6.0 for i, y in enumerate(STRIPS_MM)])
    assert found.mean_share(0.0) == pytest.approx(true, abs=0.03)
    assert (found.strip_y_mm, found.strip_sensors) == ((0, 12, 24, 36), made.NAMES)
    assert ("warning: presses at one distance differ" in done.stdout) == (law != "strips")
    assert load_scene(made.scene(spreading_file=str(folder / f"{law}.yaml"))).surface.known


POSITIONS = {
    "0, 12, 24, 36.3": ("abcd", (0, 12, 24, 36.3)),
    "0, 13.8, 27.6, 41.4": ("abcd", (0, 13.8, 27.6, 41.4)),
    "a, c, b, d": ("acbd", (0, 12, 24, 36)),
    "d, c, b, a": ("abcd", (36, 24, 12, 0)),
}


@pytest.mark.parametrize("found", POSITIONS)
def test_a_skin_calibrated_with_strips_elsewhere_is_refused(found, folder):
    """Readings of y would be wrong by millimetres without a flag."""
    names, across = POSITIONS[found]
    strips = [{"sensor": name, "y_mm": y} for name, y in zip(names, across, strict=True)]
    (folder / "moved.yaml").write_text(
        yaml.safe_dump(made.scene(spreading_file="skin.yaml", strips=strips))
    )
    line = refused("plan", "moved.yaml", cwd=folder)
    known = "a, b, c, d" if "a" in found else "y_mm = 0, 12, 24, 36"
    assert "moved.yaml: surface.spreading_file: skin.yaml: must be a law of strips" in line
    assert line.endswith(f"calibrated with {known}, got {found}")


def test_a_skin_is_accepted_wherever_its_surface_lies(folder):
    # Another origin, and the error with which strips are placed by hand.
    across = -100.0, -88.2, -76.0, -64.0
    strips = [{"sensor": name, "y_mm": y} for name, y in zip("wxyz", across, strict=True)]
    scene = made.scene(spreading_file=str(folder / "skin.yaml"), strips=strips)
    for sensor, name in zip(scene["sensors"], "wxyz", strict=True):
        sensor["name"] = name
    assert load_scene(scene).surface.known


def change_taps(folder, change):
    """Write the table of taps with its rows (n, 5) changed."""
    rows = np.loadtxt(folder / "taps.csv", delimiter=",", skiprows=1)
    made.write_taps(folder / "changed.csv", change(rows))


SUSPICIONS = {
    "a strip farther away bears more than the nearest one in": lambda t: (
        (0, 0, 0, 0, 36) + t * (1, 1, 1, 1, -1)
    ),
    "strips show presses up to 10.": lambda t: t + (0, 0, 0, 10, 0),
    "the strips together bear at most 1.1% of a press; is force_n in N": lambda t: (
        t * (1, 1, 102, 1, 1)
    ),
    "presses at one distance differ; check times": lambda t: t + (0.18, 0.18, 0, 0, 0),
}


@pytest.mark.parametrize("message", SUSPICIONS)
def test_skin_calibration_suspicion_must_be_accepted_and_is_repeated(message, folder, tmp_path):
    """The law explains such presses well, but the surface was read elsewhere or in grams."""
    change_taps(folder, SUSPICIONS[message])
    said = refused_taps(folder, "changed.csv")
    assert f"changed.csv: {message}" in said and said.endswith("nevertheless with --accept)")
    accepted = tmp_path / "accepted.yaml"
    done = succeeded(*command_of("changed.csv", accepted), "--accept", cwd=folder)
    assert f"not to be trusted: {message}" in done.stdout
    (found, *_) = read_spreading(accepted).suspicions
    assert found.startswith(message)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(made.scene(spreading_file=str(accepted))))
    repeated = f"surface 'skin' was calibrated in spite of a suspicion: {found}"
    assert f"warning: {repeated}\n" in succeeded("plan", tmp_path / "scene.yaml").stdout


def test_three_presses_between_strips_are_seven_shares_and_the_report_names_errors(folder):
    """The documentation asked for six presses, and for errors that the report does not state."""
    # At 40 mm along, 5 or 8 N; two or three strips are touched by each.
    change_taps(folder, lambda t: t[(t[:, 3] == 40) & np.isin(t[:, 4], (6, 15, 33))])
    done = calibrate_again(folder, "changed.csv", "three.yaml", "table")
    assert "table law from 7 shares of touched strips" in done.stdout
    found = read_spreading(folder / "three.yaml")
    line = f"standard deviation of a share {found.share_std:.3f} (rms residual 0.0"
    assert line in done.stdout and ", with the noise of the strips)" in done.stdout


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("bear at most", lambda t: t * (1, 1, 0.5, 1, 1)),
        (
            "must have presses at 3 values of y_mm",
            lambda t: np.column_stack([t[:, :4], 12 * (t[:, 4] > 12)]),
        ),
    ],
)
def test_presses_that_no_skin_explains_are_refused(message, change, folder):
    """Forces in another unit, and presses that leave nothing to judge the law by."""
    change_taps(folder, change)
    assert message in refused_taps(folder, "changed.csv")


def calibrate_in_parts(folder, to, parts, seed):
    """Calibrate from intervals in which each tap is read at these parts of its force."""
    rng = np.random.default_rng(seed)
    taps = made.known_presses()
    presses = [[(part * force, x, y)] for force, x, y in taps.tolist() for part in parts]
    (to / "bare.yaml").write_text((folder / "bare.yaml").read_text())
    with open_writer(to / "readings.csv") as writer:
        for reading in made.readings_of(plan(to / "bare.yaml"), presses, rng):
            writer.write(reading)
    made.write_taps(to / "taps.csv", made.timed(taps, each=len(parts)))
    return run_command(*command_of("taps.csv", "skin.yaml"), cwd=to)


def test_skin_calibration_intervals_with_the_rise_of_presses_read_the_same_forces(
    folder, tmp_path, presses
):
    """Forces were read 3 to 7 % too high, by up to seven standard deviations, and nothing said."""
    done = calibrate_in_parts(folder, tmp_path, (0.5, 1, 1, 1, 1), 16)
    assert done.returncode == 0 and "warning" not in done.stdout, done.stdout + done.stderr
    held, found = (read_spreading(each / "skin.yaml") for each in (folder, tmp_path))
    assert np.array(found.strip_shares) == pytest.approx(np.array(held.strip_shares), abs=0.02)
    assert found.share_std < 0.01
    scene = made.scene(spreading_file=str(tmp_path / "skin.yaml"))
    new = presses[:10]
    readings = made.readings_of(plan(scene), new[:, None].tolist(), np.random.default_rng(17))
    error, std, true = made.errors_of(made.of_surface(readings), new)
    assert len(error) == 10
    assert abs(np.mean(error[:, 0] / true[:, 0])) < 0.01
    assert np.sqrt(np.mean((error[:, 0] / std[:, 0]) ** 2)) < 1.5


def test_skin_calibration_forces_that_change_widen_the_stated_error(folder, tmp_path):
    """No residual shows an error that is alike in all taps."""
    done = calibrate_in_parts(folder, tmp_path, (0.7, 0.85, 1), 18)
    assert done.returncode == 0 and "warning: forces change between start_s" in done.stdout
    # The median press has 0.85 of its force, and half of the readings differ by 0.15 of it.
    share = read_spreading(folder / "skin.yaml").mean_share(0.0)
    found = read_spreading(tmp_path / "skin.yaml")
    assert found.mean_share(0.0) == pytest.approx(0.85 * share, abs=0.02)
    assert found.share_std >= 0.5 * (share - found.mean_share(0.0))


def test_skin_calibration_intervals_mostly_without_a_press_do_not_count(folder, tmp_path):
    """Strips that were released counted as untouched under the press, whose share became less."""
    assert "no strip shows a press for more than half of the time from start_s" in (
        calibrate_in_parts(folder, tmp_path, (1, 0.01, 0.01), 19).stderr
    )

    def shorten(taps):
        """Two of three intervals are those of the press alone."""
        alone = np.arange(len(taps)) % 3 > 0
        taps[alone, 1] = taps[alone, 0] + made.PERIOD_S
        return taps

    change_taps(tmp_path, shorten)
    calibrate_again(tmp_path, "changed.csv", "skin.yaml")
    held, found = (read_spreading(each / "skin.yaml") for each in (folder, tmp_path))
    assert found.mean_share(0.0) == pytest.approx(held.mean_share(0.0), abs=0.02)


@pytest.mark.parametrize("law", ["table", "gaussian"])
def test_the_stated_error_of_a_share_is_not_below_that_of_the_fit(law):
    """Presses at the edge contradict each other; they are never left out of the fit."""
    skin = skin_of(load_scene("surface_four_strips"))
    y = np.repeat([0.0, 18.0, 36.0], 4)
    force, x = np.full(12, 6.0), np.full(12, 40.0)
    scale = np.where(y == 18, 1.0, np.tile([1.5, 0.5], 6))
    shown = force[:, None] * skin.shares(y) * scale[:, None]
    one = np.ones_like(shown)
    taps = SurfaceTaps(force, x, y, shown, 0.01 * one, 40 * one, 0.1 * one, one < 0, 0 * one)
    found, rms = fit_spreading(skin, taps, law)
    assert rms == pytest.approx(0.13, abs=0.02)
    assert found.share_std == pytest.approx(rms, rel=0.02)


def test_an_untouched_surface_has_a_row_without_a_press_and_one_that_is_not_calibrated_none(
    folder, settings
):
    readings = made.readings_of(settings, [[]] * 5, np.random.default_rng(13))
    own = made.of_surface(readings)
    assert [(r.touch, r.force_n, r.y_mm) for r in own] == [(0, None, None)] * 5
    press = [[(6.0, 40.0, 12.0)]]
    strips = made.readings_of(plan(folder / "bare.yaml"), press, np.random.default_rng(15))
    assert {r.sensor for r in strips} == set(made.NAMES)


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
    "surface.strips[1].y_mm: must lie 0.1 mm or more from": {"strips": [
        {"sensor": "a", "y_mm": 3}, {"sensor": "b", "y_mm": 3}]},
    "surface.strips: must overlap along x; see x_mm and direction: what all of them are calibrated "
    "for begins at x = 120 mm and ends at 60 mm": {"strips": [
        {"sensor": "a", "y_mm": 0}, {"sensor": "b", "y_mm": 9, "x_mm": 100}]},
    "surface.name: must differ from the name of every sensor": {"name": "b"},
    "surface.name: must not be 'skin' where a sensor is named 'skin-2', since rows of the second": {
        "presses": 2, "sensor": "skin-2"},
    "surface.spreading.share: is missing": {"spreading": {"width_mm": 5}},
    "surface.spreading.distance_mm: must begin with 0 and rise": {"spreading": {
        "law": "table", "distance_mm": [0, 5, 4], "shares": [0.5, 0.2, 0]}},
    "surface.spreading.shares: must have as many numbers as distance_mm, 2": {"spreading": {
        "law": "table", "distance_mm": [0, 5], "shares": [0.5, 0.2, 0]}},
    "surface.spreading.shares: must not rise with the distance, by more than 0.05": {"spreading": {
        "law": "table", "distance_mm": [0, 5, 10], "shares": [0.1, 0.5, 0.9]}},
    "surface.spreading: must let all strips together bear at most 118% of a press (110 %, and "
    "twice share_std); at y = 18.0 mm they bear 193%": {"spreading": {"share": 1, "width_mm": 9.4}},
    "surface.spreading.distance_mm: must be left out, the law 'gaussian' does not have it": {
        "spreading": {"share": 0.5, "width_mm": 9, "distance_mm": [0, 5], "shares": [0.5, 0]}},
    "surface.spreading: must be a law of as many strips as the surface has, 4": {"spreading": {
        "law": "strips", "distance_mm": [0, 5], "strip_shares": [[0.5, 0.2], [0.5, 0.2]]}},
    "surface.spreading: must be a law of as many strips as the surface has, 4, got 3": {
        "spreading": {"share": 0.5, "width_mm": 9, "location_offsets_mm": [0.1, 0, 0]}},
    "surface.spreading_file: nowhere.yaml: cannot be read (No such file or directory); leave": {
        "spreading_file": "nowhere.yaml"},
    "surface.spreading_file: must be left out": {
        "spreading": {"share": 0.5, "width_mm": 9}, "spreading_file": "x.yaml"},
}  # fmt: skip


@pytest.mark.parametrize("message", BAD)
def test_a_bad_surface_is_refused_in_one_line(message, tmp_path):
    scene = made.scene(**BAD[message])
    if renamed := scene["surface"].pop("sensor", None):
        scene["sensors"][3]["name"] = scene["surface"]["strips"][3]["sensor"] = renamed
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(scene))
    assert f"bad.yaml: {message}" in refused("plan", "bad.yaml", cwd=tmp_path)


TAPS = "start_s,end_s,force_n,x_mm,y_mm\n"
BAD_TAPS = {
    "must have the columns start_s, end_s, force_n, x_mm, y_mm": "start_s,end_s,force_n\n1,2,3\n",
    "row 2: force_n: must be finite": TAPS + "1,2,nan,40,0\n",
    "row 2: y_mm: must be a number": TAPS + "1,2,5,40,\n",
    "row 2: force_n must be above 0": TAPS + "1,2,0,40,0\n",
    "row 2: end_s must be later than start_s": TAPS + "2,1,5,40,0\n",
    "row 2: x_mm must lie on a strip, 0 to 80 mm, got 500.0": TAPS + "0.54,0.58,5,500,0\n",
    "row 2: y_mm must lie within 3 strip distances of the strips, -36 to 72 mm, got 73.0": TAPS
    + "0.54,0.58,5,40,73\n",
    "must press strips 6 times or more; a press counts once for each strip that shows it, got ":
    TAPS + "0.54,0.58,5,40,0\n",
    "no strip shows a press for more than half of the time from start_s to": TAPS
    + "9000,9001,5,40,0\n",
    "has no rows": TAPS,
}  # fmt: skip


@pytest.mark.parametrize("message", BAD_TAPS)
def test_bad_taps_are_refused_in_one_line(message, folder):
    (folder / "bad.csv").write_text(BAD_TAPS[message])
    assert message in refused_taps(folder, "bad.csv")


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
    assert message in refused("calibrate", *arguments, "-o", "other.yaml", cwd=folder)


PRESSES, NOISE_DEG = 400, 4.0


def test_force_on_one_strip_is_no_better_known_than_stated():
    """Beside strips below their onset the force was stated five standard deviations off."""
    skin = plan("surface_four_strips").skin
    rng, count = np.random.default_rng(6), len(skin.strips)
    force = rng.uniform(1.2, 8, PRESSES)
    x, y = rng.uniform(25, 55, PRESSES), rng.uniform(*skin.y_span_mm, PRESSES)
    error = skin.spreading.share_std * rng.standard_normal((PRESSES, count))
    borne = (skin.shares(y) + error) * force[:, None]
    touched = borne > skin.untouched_below_n
    phases = np.zeros((PRESSES, count, 2))
    for i, strip in enumerate(skin.strips):
        begin, end = strip.x_of(0.0), strip.x_of(1.0)
        own = (x - begin) / (end - begin) + skin.spreading.offset_mm(i)
        pressed = np.maximum(borne[:, i], 0.05)
        phases[:, i] = strip.model.phases_deg(pressed, own, skin.frequency_hz)
    phases += NOISE_DEG * rng.standard_normal(phases.shape)
    std, usable = np.full(phases.shape, NOISE_DEG), np.ones(touched.shape, bool)
    found = SurfaceEstimator(skin).read(phases, std, usable, touched)
    one = (touched.sum(axis=1) == 1) & ~found.inconsistent[:, 0]
    away = (found.mean[one, 0, 0] - force[one]) / np.sqrt(found.covariance[one, 0, 0, 0])
    assert one.sum() > PRESSES / 5
    assert np.abs(away).max() < 4
    assert (np.abs(away) < 2).mean() > 0.95
