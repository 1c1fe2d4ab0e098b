# SPDX-License-Identifier: GPL-3.0-or-later
"""Time stamps of real cards that err, and clocks that step back."""

import numpy as np
import pytest
from card_rooms import (
    FORCE_N,
    capture_of,
    readings_of,
    readings_of_rooms,
)
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from long_cases import cases

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
    assert len(clear) > 0.75 * len(steady) and (clear["touch"] == 1).all()
    assert stds.max() < 4
    # Standard deviations of the force also contain the drift that ten groups of reference allow.
    assert (steady["snr_db"].to_numpy() < exact["snr_db"].to_numpy() + 0.1).all()
    assert steady["snr_db"].mean() < exact["snr_db"].mean() - 0.1


@pytest.mark.parametrize("seed", cases(5, long=(6, 7)))
@pytest.mark.parametrize("stamps", cases({"stamp_grid_s": 1e-3}, long=({"stamp_s": 1e-3},)))
def test_time_stamps_that_err_by_1_ms_give_no_wrong_reading(stamps, seed, tmp_path):
    """A millisecond is half a period of the tag's fourth line: readings are flagged or right."""
    _, clear, stds = readings_of_rooms(29, (seed,), tmp_path, **stamps)
    assert (clear["touch"] == 1).all() and stds.max(initial=0) < 4


def test_clock_that_steps_back_is_a_gap_and_readings_go_on(tmp_path):
    """The file was refused; an Intel 5300 does this within 90 s."""
    capture = capture_of(35, duration_s=12.0, touched_s=(3.0, 12.0), clock_back_s=5.0)
    readings, *_ = readings_of(capture, tmp_path)
    recording = open_snapshots(tmp_path / "p.npz")
    assert recording.clock_steps == 1 and recording.span_s > 40
    assert any("stepped back once" in note for note in recording.notes)
    later = readings[readings["time_s"] > 37.5]
    clear = later[later["flags"] == ""]
    assert len(clear) > 0.5 * len(later) > 5
    assert (np.abs(clear["force_n"] - FORCE_N) < 4 * clear["force_std_n"]).all()
