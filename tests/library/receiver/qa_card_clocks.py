# SPDX-License-Identifier: GPL-3.0-or-later
"""Time stamps of real cards that err, and clocks that step back."""

import numpy as np
import pytest
from card_rooms import FORCE_N, capture_of, readings_of_rooms, scene_of
from gnuradio import wiforce
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.ends.separation import EndSeparator
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.packets.packet_channels import undivided
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from gnuradio.wiforce.receiver.snapshot_reader import PacketGroups
from gnuradio.wiforce.signal.waveform import packet_waveform
from gnuradio.wiforce.signal.weights import timed_table
from long_cases import cases
from packet_simulator import closed

LINE_DB = 29


@pytest.fixture(scope="module")
def rooms(long_run):
    return (5, 6, 7) if long_run else (5,)


@pytest.fixture(scope="module")
def exact(rooms, tmp_path_factory):
    """Steady readings with exact time stamps."""
    return readings_of_rooms(LINE_DB, rooms, tmp_path_factory.mktemp("exact"))[0]


@pytest.mark.parametrize("stamps", cases({"stamp_grid_s": 1e-4}, long=({"stamp_s": 1e-4},)))
def test_time_stamps_that_err_by_100_us_are_read_as_noise(stamps, rooms, exact, tmp_path):
    """They refused the whole file, with an infinite ratio of the tag."""
    steady, clear, stds = readings_of_rooms(LINE_DB, rooms, tmp_path, **stamps)
    assert len(clear) >= 0.7 * len(steady) and (clear["touch"] == 1).all()
    assert stds.max() < 4
    # Standard deviations of the force also contain the drift that six groups of reference allow.
    assert (steady["snr_db"].to_numpy() < exact["snr_db"].to_numpy() + 0.1).all()
    assert steady["snr_db"].mean() < exact["snr_db"].mean() - 0.1


@pytest.mark.parametrize("seed", cases(5, long=(6, 7)))
@pytest.mark.parametrize("stamps", cases({"stamp_grid_s": 1e-3}, long=({"stamp_s": 1e-3},)))
def test_time_stamps_that_err_by_1_ms_give_no_wrong_reading(stamps, seed, tmp_path):
    """A millisecond is half a period of the tag's fourth line: readings are flagged or right."""
    _, clear, stds = readings_of_rooms(29, (seed,), tmp_path, **stamps)
    assert (clear["touch"] == 1).all() and stds.max(initial=0) < 4


@pytest.mark.parametrize("seed", cases(3, long=(1, 2)))
def test_clock_of_a_tag_in_few_irregular_packets_errs_by_less_than_a_degree(seed):
    """It was off by 4 degrees, as slopes of its likelihood say little; packets had wrong ends."""
    rng, rate_hz = np.random.default_rng(seed), 134 * (1 + 30e-6)
    time_s = np.sort(rng.uniform(0, 24, 24 * 90))
    cycles = rate_hz * time_s + 0.3
    ends, noise = (rng.normal(size=(n, 16, 2)) @ [1, 1j] for n in (2, len(time_s)))
    channel = closed(cycles) @ ends + 0.2 * noise
    table = timed_table([134.0], time_s[:90] - 0.5, 1.0)
    waveform = packet_waveform(1 / 90, 6.4e-6, 312.5e3 * np.arange(16))
    separator = EndSeparator(table, [TagClock(134.0)], waveform, derotated=False)
    groups = PacketGroups(table, undivided(channel[:, :, None], time_s)).read(0, 24)
    found = Groups.concatenate([separator.process(groups), separator.flush()])
    assert len(found) == 24 and found.locked.all()
    error = found.clock_phase[:, 0] - 2 * np.pi * (rate_hz * (found.index + 0.5) + 0.3)
    assert np.abs(np.angle(np.exp(1j * error))).max() < np.radians(1)
    assert np.abs(found.clock_offset_ppm - 30).max() < 2


def test_clock_that_steps_back_is_a_gap_and_readings_go_on(tmp_path):
    """The file was refused; an Intel 5300 does this within 90 s. The 30 s that are assumed there
    made packets every millisecond come every 5 ms on average.
    """
    capture = capture_of(35, subcarriers=8, duration_s=5.5, touched_s=(2.5, 5.5), clock_back_s=3.5)
    capture.save(tmp_path / "p.npz")
    recording = open_snapshots(tmp_path / "p.npz")
    assert recording.clock_steps == 1 and recording.span_s > 35
    with pytest.warns(UserWarning) as said:
        readings = wiforce.read(tmp_path / "p.npz", scene_of())
    said = " ".join(str(each.message) for each in said)
    assert "stepped back once" in said and "packets come every" not in said
    later = readings[readings["time_s"] > 34.5]
    read = later[later["touch"] == 1]
    assert len(read) >= 3 and len(later) == 4 and (read["force_std_n"] < 2).all()
    assert (np.abs(read["force_n"] - FORCE_N) < 4 * read["force_std_n"]).all()
