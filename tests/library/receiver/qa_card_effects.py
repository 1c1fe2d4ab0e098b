# SPDX-License-Identifier: GPL-3.0-or-later
"""What real cards add to channel snapshots: flips, strong tags, other senders, poor time stamps."""

import numpy as np
import pytest
from card_rooms import (
    FORCE_N,
    LOCATION_MM,
    capture_of,
    readings_of,
    readings_of_rooms,
    scene_of,
)
from gnuradio import wiforce
from gnuradio.wiforce.estimation.packets.antenna_states import (
    LEAST_STEP,
    find_states,
    find_states_beside_tags,
)
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.snapshot_reader import SnapshotReader
from long_cases import cases
from packet_simulator import PacketCapture, PacketTag, card_settings


@pytest.mark.parametrize("seed", cases(1, long=(2, 3)))
def test_wander_between_antennas_costs_little_of_what_subcarriers_tell(seed, tmp_path):
    """At the lines of a tag it exceeds the noise of all subcarriers, which share it."""
    settings = card_settings("fast", 29, wander=0.009, ripple=0.0, subcarriers=26)
    settings |= {"seed": seed, "duration_s": 1.5, "touched_s": (0.6, 1.5)}
    capture = PacketCapture([PacketTag(134.0)], **settings)
    interval_s = float(np.mean(np.diff(capture.time_s)))
    scene = scene_of() | {"packets": {"interval_s": interval_s}, "reference_s": 0.5}
    scene["phase_group"] = {"snapshots": round(0.1 / interval_s)}
    steady, clear, stds = readings_of(capture, tmp_path, scene, 0.7, 1.4)
    assert len(clear) >= 0.75 * len(steady)
    assert (clear["force_n"] - FORCE_N).abs().max() < 0.4 and stds.max() < 3


SHORT = {"duration_s": 3.75, "touched_s": (2.0, 3.75)}
STEADY = {"chain_states": (), "drift_deg": 0.0, "ripple": 0.0, "subcarriers": 26}


@pytest.mark.parametrize(
    "effects, least, within_n", cases((STEADY, 0.75, 0.45), long=(({}, 0.0, np.inf),))
)
def test_tag_in_an_irregular_capture_of_an_ax200_gives_no_wrong_reading(
    effects, least, within_n, tmp_path
):
    """With the SNR, flips, steps, drift and intervals of a real file, 22 dB below the path."""
    settings = card_settings("slow", 22, **effects)
    settings |= {"seed": 1, "duration_s": 12.0, "touched_s": (7.0, 12.0)}
    scene = scene_of() | {"packets": {"interval_s": 0.006}, "reference_s": 6.0}
    scene["phase_group"] = {"snapshots": 167}
    capture = PacketCapture([PacketTag(134.0)], **settings)
    steady, clear, stds = readings_of(capture, tmp_path, scene, 8, 11)
    assert len(clear) >= least * len(steady) and (clear["touch"] == 1).all()
    assert (stds < 4).all() and ((clear["force_n"] - FORCE_N).abs() < within_n).all()


@pytest.mark.parametrize(
    "line_db, seeds, phases",
    cases((22, (5,), 4), long=((22, (11, 13), 2), (29, (5, 6, 8), 4))),
)
def test_phases_that_flip_between_antennas_are_followed(line_db, seeds, phases, tmp_path):
    """An AX200 flips several times per second: no reading was without a flag."""
    effects = {"flip_s": 0.4, "flip_phases": phases} | SHORT
    steady, clear, stds = readings_of_rooms(line_db, seeds, tmp_path, **effects)
    assert len(clear) >= 0.7 * len(steady) and (clear["touch"] == 1).all()
    errors = np.abs(clear["force_n"] - FORCE_N)
    # In room 5 the tag has an SNR of -4 dB, and forces a standard deviation of 0.3 N.
    assert np.quantile(errors, 0.9) < 0.6 and stds.max() < 4
    assert np.abs(clear["location_mm"] - LOCATION_MM).max() < 0.5


def test_own_part_of_a_strong_tag_is_solved_and_another_sender_left_out(tmp_path):
    """Its curvature was a standard deviation: near tags were `weak`, however high their SNR."""
    capture = capture_of(22, snr_db=35.0, strangers=0.1, repeated=0.0)
    capture.save(tmp_path / "p.npz")
    reader = SnapshotReader(open_snapshots(tmp_path / "p.npz"), plan(scene_of()))
    steady = [reading for batch in reader for reading in batch if 2.25 < reading.time_s < 4.25]
    clear = [reading for reading in steady if not reading.flags]
    assert len(clear) > 0.75 * len(steady)
    assert max(abs(each.force_n - FORCE_N) / each.force_std_n for each in clear) < 4
    assert np.median([each.force_std_n for each in clear]) < 0.25
    (note,) = [note for note in reader.notes if "another sender" in note]
    count = int(note.split()[2])
    assert abs(count - 0.1 * len(capture.time_s)) < 0.03 * len(capture.time_s)


def test_subcarriers_that_do_not_follow_the_others_are_left_out(tmp_path):
    """An AX200 reports no channel on its pilots, which halved the information of all packets."""
    capture_of(22, duration_s=2.0, snr_db=9.0).save(tmp_path / "a.npz")
    assert open_snapshots(tmp_path / "a.npz").channel.shape[1] == 16
    capture = capture_of(22, duration_s=2.0)
    rng, n = np.random.default_rng(1), len(capture.time_s)
    turns = np.exp(2j * np.pi * rng.random((n, 1)))
    level = np.abs(capture.channel).mean()
    capture.channel[:, 5] = level * turns
    capture.channel[:, :2] *= np.exp(1j * 1.2 * rng.standard_normal((n, 1, 1)))
    capture.channel[:, 0] *= np.exp(1j * rng.standard_normal((n, 1)))
    capture.save(tmp_path / "b.npz")
    found = open_snapshots(tmp_path / "b.npz")
    assert np.array_equal(found.subcarrier_hz, np.delete(capture.subcarrier_hz, [0, 1, 5]))
    assert any("left out 3 x subcarrier" in note for note in found.notes)


@pytest.mark.parametrize("line_db", cases(60, long=(50,)))
def test_gains_of_single_antennas_that_step_are_followed(line_db, tmp_path):
    """Steps hide a weak tag, whose clock is then not found."""
    capture = capture_of(line_db, snr_db=line_db + 5, flip_s=0.4, chain_gain_db=1.5, **SHORT)
    steady, clear, stds = readings_of(capture, tmp_path)
    assert len(clear) > 0.75 * len(steady) and stds.max() < 4


def test_states_of_the_chains_hold_no_tag_and_no_room():
    """A state that follows a press would turn the readings by what the press did."""
    still = capture_of(22)
    assert find_states(still.channel, still.subcarrier_hz, 1.0).count == 1
    flipping = capture_of(60, flip_s=0.4)
    assert find_states(flipping.channel, flipping.subcarrier_hz, LEAST_STEP).count == 2
    changed = capture_of(60, change_db=-15.0)
    assert find_states(changed.channel, changed.subcarrier_hz, LEAST_STEP).count == 1


def test_state_is_right_in_packets_whose_clock_errs_by_an_edge_of_a_switch():
    """Wrong states then confirmed the wrong clock, which stayed 3 degrees off."""
    rng = np.random.default_rng(2)
    hertz, closed = 312.5e3 * np.arange(16), np.zeros((3, 400, 2))
    free = np.ones((400, 16, 2), complex) + 0.01 * rng.standard_normal((400, 16, 2))
    free[:, :, 0] *= 2
    flipped, shut = rng.random(400) < 0.3, np.arange(400) < 160
    free[flipped, :, 1] *= 1.12
    closed[:, shut, 0] = 1
    closed[0, :20, 0] = 0  # by their times these packets find it open
    closed[1, 160:180, 0] = 1  # an error the other way round adds others
    tag = np.array([0, 0.2])
    channels = free + (shut - closed[:, :, 0])[:, :, None, None] * tag
    switches = np.ones(400, bool), closed, np.zeros(400, int)
    found, best = find_states_beside_tags(channels, hertz, LEAST_STEP, *switches)
    assert np.array_equal(found.label, flipped)
    assert (best[:20] > 0).all() and (best[160:180] != 1).all()


def test_phase_that_flips_shortly_before_the_end_is_a_state():
    """It ended the program with an IndexError."""
    rng = np.random.default_rng(1)
    channel = np.ones((100, 16, 2), complex) + 0.01 * rng.standard_normal((100, 16, 2))
    label = np.repeat([0, 1], [75, 25])
    channel[75:, :, 1] *= -1
    assert np.array_equal(find_states(channel, np.arange(16.0), LEAST_STEP).label, label)


def simulated(folder, static_clutter_db, **effects):
    """What the product's simulator writes of 4 s of a tag at its noise."""
    scene = {
        "packets": {"subcarriers": 8, "interval_s": 0.002},
        "radio": {"center_frequency_hz": 2.44e9},
        "phase_group": {"snapshots": 100},
        "sensors": [{"name": "tag", "model": "line-2440mhz", "clock_hz": 134}],
        "simulation": {
            "duration_s": 4,
            "seed": 1,
            "snr_db": 0,
            "static_clutter_db": static_clutter_db,
            "packets": effects,
        },
    }
    wiforce.simulate(scene, folder / "a")
    return open_snapshots(folder / "a.npz")


def test_simulated_card_flips_steps_and_rounds(tmp_path):
    effects = {"flips_per_s": 3, "flip_phases": 3, "antenna_gain_step_db": 2, "clock_steps": 1}
    effects |= {"stamp_jitter_s": 1e-4, "stamp_resolution_s": 1e-3}
    found = simulated(tmp_path, 35, **effects)
    assert found.clock_steps == 1
    steps = np.diff(found.time_s) * 1e3
    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    between = np.mean(found.channel[:, :, 1] * found.channel[:, :, 0].conj(), axis=1)
    turns = np.angle(between / between[0]) / (2 * np.pi) * 3
    assert np.median(np.abs(turns - np.rint(turns))) < 0.1
    assert set(np.unique(np.rint(turns).astype(int) % 3)) == {0, 1, 2}
    size = np.mean(np.abs(found.channel) ** 2, axis=1)
    gain_db = 10 * np.log10(size[:, 1] / size[:, 0])
    assert 5.0 < np.ptp(np.quantile(gain_db, [0.05, 0.95])) < 10.0


def test_simulated_antennas_wander_by_the_stated_deviations(tmp_path):
    effects = {"antenna_wander_db": 1.0, "antenna_wander_deg": 10.0}
    found = simulated(tmp_path, 45, **effects)
    ratio = np.mean(found.channel[:, :, 1] / found.channel[:, :, 0], axis=1)
    assert np.std(20 * np.log10(np.abs(ratio))) == pytest.approx(1.0, rel=0.15)
    turns = np.angle(ratio / ratio.mean(), deg=True)
    assert np.std(turns) == pytest.approx(10.0, rel=0.15)
