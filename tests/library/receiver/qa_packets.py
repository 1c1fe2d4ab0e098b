# SPDX-License-Identifier: GPL-3.0-or-later
"""Channel snapshots of packets: accuracy against an independent simulator, and what is refused."""

import json
from pathlib import Path

import card_rooms
import numpy as np
import pandas as pd
import pytest
import yaml
from command_runs import refused, run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from gnuradio.wiforce.planning.advice import warnings as warnings_of
from gnuradio.wiforce.planning.clocks import clocks_for
from gnuradio.wiforce.planning.plan import plan
from packet_simulator import PacketCapture, PacketTag

PERIOD_S = 0.5
REFERENCE_GROUPS = 6


def scene_of(clocks_hz=(120, 134), **more):
    """The scene to read captures of the independent simulator with: 450 packets in 0.5 s."""
    groups = {"phase_group": {"snapshots": 450}, "reference_s": REFERENCE_GROUPS * PERIOD_S}
    return card_rooms.scene_of(clocks_hz) | groups | more


def capture_of(seed=1, **more):
    """4 N at 35 mm and 3 N at 50 mm, by the phases of the model: tags 60 dB below the room."""
    tags = [
        PacketTag(120.0, phase=0.3),
        PacketTag(134.0, touched_deg=(-98.963, 53.553), offset_ppm=-20.0, phase=0.77),
    ]
    settings = {"static": 225.0, "noise": 1.0, "duration_s": 10.0, "touched_s": (4.0, 9.5)}
    return PacketCapture(tags, seed=seed, **(settings | more))


def readings_of(capture, folder, scene=None):
    capture.save(folder / "p.npz")
    return card_rooms.quietly_read(folder / "p.npz", scene or scene_of())


def touched(readings, capture):
    """Readings of the groups in which nothing changes, sensor by sensor."""
    first = int(capture.touched_s[0] / PERIOD_S) + 2
    last = int(capture.touched_s[1] / PERIOD_S) - 1
    inside = readings[(readings["group"] >= first) & (readings["group"] < last)]
    return [inside[inside["sensor"] == f"tag{i}"] for i in range(len(capture.tags))]


def phase_errors(readings, capture):
    """Errors of the phases and their bounds, of both ends of all tags in one row each."""
    bound = capture.bound_deg(PERIOD_S, REFERENCE_GROUPS)
    errors, bounds = [], []
    for i, own in enumerate(touched(readings, capture)):
        for end in (0, 1):
            found = own[f"phase{end + 1}_deg"].to_numpy() - capture.tags[i].touched_deg[end]
            errors.append((found + 180) % 360 - 180)
            bounds.append(bound[own["group"].to_numpy(int), i, end])
    return np.array(errors), np.array(bounds)


def excess_db(errors, bounds):
    return 10 * np.log10(np.mean(errors**2) / np.mean(bounds**2))


@pytest.fixture(scope="module")
def acceptance(tmp_path_factory):
    """Exponential gaps, 10 % lost, repeats, gain steps, timing offsets; and their readings."""
    capture = capture_of(seed=2, subcarriers=26)
    return capture, readings_of(capture, tmp_path_factory.mktemp("packets"))


def test_phases_of_two_tags_are_within_1_5_db_of_their_bound(acceptance):
    """One of them at a multiple of the mains; a reader that resampled the packets would fail."""
    errors, bounds = phase_errors(acceptance[1], acceptance[0])
    assert errors.shape == (4, 8)
    assert excess_db(errors, bounds) < 1.5
    assert 0.3 < np.sqrt(np.mean(bounds**2)) < 2.5


def test_force_and_location_are_those_pressed_and_flags_are_empty(acceptance):
    capture, readings = acceptance
    for own, force, location in zip(touched(readings, capture), (4, 3), (35, 50), strict=True):
        assert (own["flags"] != "").sum() <= 3 and (own["touch"] == 1).all()
        assert abs(own["force_n"].median() - force) < 0.35
        assert abs(own["location_mm"].median() - location) < 0.2
        assert (np.abs(own["force_n"] - force) < 2 * own["force_std_n"]).mean() > 0.85


def test_repeats_and_unusable_packets_are_counted_and_change_nothing(tmp_path):
    capture = capture_of(duration_s=1.0)
    channel = capture.channel.copy()
    channel[100], channel[200, 3, 1] = 0, np.nan
    capture.channel = channel
    capture.save(tmp_path / "a.npz")
    found = open_snapshots(tmp_path / "a.npz")
    repeats = len(capture.time_s) - len(np.unique(capture.time_s))
    assert repeats > 5
    (_, repeated), (_, unusable) = found.left_out
    assert abs(repeated - repeats) <= 2 and unusable in (2, 3)
    assert len(found.time_s) + repeated + unusable == len(capture.time_s)
    assert np.all(np.diff(found.time_s) > 0)


ONE = {"environment": {"receive_antennas": 1}}


def test_one_antenna_over_80_mhz_is_read_within_2_db_of_its_bound(tmp_path):
    """Tags 60 dB below the static path; a packet's phase was thought to hide all of them."""
    capture = capture_of(6, antennas=1, subcarriers=32, spacing_hz=2.5e6, noise=0.35)
    readings = readings_of(capture, tmp_path, scene_of(**ONE))
    errors, bounds = phase_errors(readings, capture)
    assert errors.shape == (4, 8) and excess_db(errors, bounds) < 2.0
    assert 0.3 < np.sqrt(np.mean(bounds**2)) < 0.8
    for own, force in zip(touched(readings, capture), (4, 3), strict=True):
        assert (own["flags"] == "").all()
        assert (np.abs(own["force_n"] - force) < 2 * own["force_std_n"]).mean() > 0.85


def test_one_antenna_over_20_mhz_gives_no_confident_errors(tmp_path):
    """Most of a tag is lost there: -5 dB are left on average, and less in this room."""
    capture = capture_of(1, antennas=1, duration_s=8.0, touched_s=(3.5, 7.5))
    capture.save(tmp_path / "one.npz")
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene_of(**ONE)))
    done = succeeded("read", "one.npz", "--scene", "scene.yaml", "-o", "a.csv", cwd=tmp_path)
    assert "one antenna leaves -" in done.stderr
    readings = pd.read_csv(tmp_path / "a.csv", keep_default_na=False, na_values={"force_n": ""})
    for own, force in zip(touched(readings, capture), (4, 3), strict=True):
        clear = own[own["flags"] == ""]
        assert len(clear) < len(own) / 2
        assert (np.abs(clear["force_n"] - force) < 3 * clear["force_std_n"]).all()


@pytest.mark.long
def test_no_tag_gives_no_clear_reading(tmp_path):
    """Noise must not be read as a press."""
    silent = PacketCapture(
        [PacketTag(120.0, level=1e-6), PacketTag(134.0, level=1e-6)],
        duration_s=8.0, static=225.0, noise=1.0,
    )  # fmt: skip
    assert len(silent.time_s) > 1000
    readings = readings_of(silent, tmp_path)
    assert len(readings) == 32 and (readings["flags"] != "").all()


def test_packets_that_stop_are_flagged_as_a_gap(tmp_path):
    capture = capture_of(subcarriers=8, noise=0.4, duration_s=7.5)
    since = capture.time_s - capture.time_s[0]
    kept = ~((since > 5.0) & (since < 5.3)) & ~((since > 6.0) & (since < 6.5))
    capture.time_s, capture.channel = capture.time_s[kept], capture.channel[kept]
    readings = readings_of(capture, tmp_path)
    flags = readings[readings["sensor"] == "tag0"].set_index("group")["flags"]
    assert "gap" in flags[10] and "gap" in flags[12]
    assert flags[14] == ""


@pytest.mark.parametrize("factor", [10.0, 1000.0])
def test_times_that_contradict_the_interval_are_named(tmp_path, factor):
    """Times in milliseconds gave a rule about lines of tags, and a slow sender only flags."""
    capture = capture_of(subcarriers=8, duration_s=4.0)
    capture.time_s = capture.time_s * factor
    capture.save(tmp_path / "p.npz")
    (tmp_path / "scene.yaml").write_text(json.dumps(scene_of()))
    done = run_command("read", "p.npz", "--scene", "scene.yaml", "-o", "a.csv", cwd=tmp_path)
    assert "p.npz: packets come every" in done.stderr.splitlines()[0]
    assert "but packets.interval_s is 0.001" in done.stderr
    assert done.returncode == (2 if factor > 10 else 0)


def test_reference_with_hardly_a_packet_is_named(tmp_path):
    """A file with nearly all its packets in one second asked for longer groups."""
    capture = capture_of(duration_s=6.5)
    since = capture.time_s - capture.time_s[0]
    kept = (since > 5.5) | (np.arange(len(since)) == 10)
    capture.time_s, capture.channel = capture.time_s[kept], capture.channel[kept]
    scene = scene_of(packets={"interval_s": 0.007}, phase_group={"snapshots": 72})
    rule = "^time_s: must hold packets throughout reference_s: .* 1 of the 72 .*; 1 of 869 packets"
    with pytest.raises(InputError, match=rule):
        readings_of(capture, tmp_path, scene)


def test_plan_says_that_a_wifi_card_has_no_such_snr():
    """The default of 10 dB is that of samples; a plan would promise a twentieth of the error."""
    assert not any("simulation.snr_db" in text for text in warnings_of(plan("wifi_packets")))
    stated = scene_of() | {"simulation": {"snr_db": 10}}
    assert any(text.startswith("simulation.snr_db: 10") for text in warnings_of(plan(stated)))


def test_simulated_scene_is_read_by_the_command(tmp_path):
    scene = yaml.safe_load((Path(DATA_DIR) / "scenes" / "wifi_packets.yaml").read_text())
    scene["simulation"] |= {"duration_s": 1.2, "presses": []}
    scene["packets"]["subcarriers"] = 8
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(scene | {"reference_s": 0.6}))
    succeeded("simulate", "short.yaml", "a", cwd=tmp_path)
    assert (tmp_path / "a.truth.csv").exists()
    done = succeeded("read", "a.npz", "-o", "a.csv", cwd=tmp_path)
    assert "repeated packet" in done.stderr
    rows = (tmp_path / "a.csv").read_text().splitlines()
    truth = (tmp_path / "a.truth.csv").read_text().splitlines()
    assert [r.split(",")[:2] for r in rows] == [t.split(",")[:2] for t in truth]
    assert json.loads(str(np.load(tmp_path / "a.npz")["scene"]))["packets"]["interval_s"] == 0.001


def test_plan_recommends_clocks_away_from_lamps_and_aliases():
    found = clocks_for(scene_of(), 2)
    assert len(found.clocks_hz) == 2 and min(found.lamp_distances_hz) >= 10
    assert all(50 <= hertz <= 200 for hertz in found.clocks_hz)
    # Every 2.6 ms, exactly: line 4 of these clocks must not alias onto lines 1 or 2.
    regular = scene_of((83,), packets={"interval_s": 0.0026, "gaps": "regular"}, reference_s=12)
    (hertz,) = clocks_for(regular, 1).clocks_hz
    rate = 1 / 0.0026
    shown = [abs((m * hertz + rate / 2) % rate - rate / 2) for m in (1, 2, 4)]
    assert min(abs(a - b) for i, a in enumerate(shown) for b in shown[:i]) > 1.0


def test_scenes_and_files_of_different_kinds_are_refused(tmp_path):
    capture = capture_of(duration_s=1.0)
    capture.save(tmp_path / "a.npz")
    assert "needs 'packets:'" in refused("read", "a.npz", "--scene", "demo", cwd=tmp_path)
    for option in (("--datatype", "ci16_le"), ("--frame-offset", "0"), ("--follow",)):
        said = refused("read", "a.npz", "--scene", "wifi_packets", *option, cwd=tmp_path)
        assert "not for channel snapshots" in said
    said = refused("read", "a.npz", "--scene", "wifi_packets", cwd=tmp_path)
    assert "phase groups or more" in said and "first frame or packet on" in said
    said = refused("emulate", "wifi_packets", cwd=tmp_path)
    assert "another device measures the channel" in said


@pytest.mark.parametrize("condition", [{"drift_deg": 12.0}, {"change_db": -25.0}])
def test_drifting_antennas_and_changed_rooms_give_no_confident_errors(condition, tmp_path):
    """Both turn the tags as a press does: readings were wrong by 5 to 50 standard deviations."""
    capture = capture_of(
        4, duration_s=8.0, touched_s=(3.5, 7.5), subcarriers=8, noise=0.42, **condition
    )
    rows = []
    readings = touched(readings_of(capture, tmp_path), capture)
    for own, force, location in zip(readings, (4, 3), (35, 50), strict=True):
        clear = own[own["flags"] == ""]
        assert (np.abs(clear["force_n"] - force) < 4 * clear["force_std_n"]).all()
        assert (np.abs(clear["location_mm"] - location) < 4 * clear["location_std_mm"]).all()
        rows.append(len(clear))
    # What the receiver does is undone, and one group may look like a change of the press; the
    # room's change makes readings uncertain.
    assert min(rows) >= 4 if "drift_deg" in condition else max(rows) == 5


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"phase_group": {"snapshots": 450, "estimator": "paper"}}, "phase_group.estimator"),
        ({"environment": {"receive_antennas": 9}}, "environment.receive_antennas"),
        ({"packets": None, "simulation": {"packets": {}}}, "simulation.packets"),
    ],
)
def test_scene_of_packets_with_a_mistake_is_refused(change, key):
    with pytest.raises(InputError, match=f"^scene: {key}"):
        wiforce.load_scene(scene_of((80,)) | change)
