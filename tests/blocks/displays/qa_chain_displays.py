# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows on the chain show the Doppler spectrum and the phases that it works with."""

import dataclasses

import numpy as np
import pmt
import pytest
from device_times import tag_at
from gnuradio import wiforce
from gnuradio.wiforce.blocks import names
from gnuradio.wiforce.blocks.group_block import state_to_pmt
from gnuradio.wiforce.estimation.groups import Groups
from press_capture import array_source, run_flowgraph

# 2000 snapshots per second.
SCENE = {
    "radio": {"sample_rate_hz": 1e6},
    "sounding": {"frame_length": 500},
    "phase_group": {"snapshots": 200},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 230}],
}


def shown(display, *items_and_tags):
    """Run items through a display."""
    run_flowgraph(array_source(*items_and_tags), display)
    return display.widget


def test_doppler_display_shows_lines_at_their_frequency_and_level(qt):
    display = wiforce.doppler_display(wiforce.plan(SCENE), snapshots=200)
    n = np.arange(400)
    # Static paths of amplitude 1, and a tag 40 dB below on every sample of the symbol.
    folded = 1 + 0.01 * np.exp(2j * np.pi * 230 * n / 2000)
    items = np.tile(folded[:, None], 64).astype(np.complex64)
    widget = shown(display, items, [tag_at(0, names.SNAPSHOT, pmt.from_uint64(0))])
    hertz, level_db = widget.series()
    assert hertz[[0, 1, -1]].tolist() == [0, 10, 1000]
    room_db = 10 * np.log10(64)
    assert level_db[[0, 23]] == pytest.approx([room_db, room_db - 40], abs=0.01)
    assert np.delete(level_db, [0, 23]).max() < room_db - 90
    assert widget.lines_hz == {"end 1": 230, "end 2": 920}
    two = wiforce.doppler_display(wiforce.plan("tabletop_two")).widget.lines_hz
    assert two == {"left end 1": 160, "left end 2": 640, "right end 1": 265, "right end 2": 1060}
    widget.refresh()
    assert not widget.grab().isNull()


def test_doppler_display_does_not_show_groups_with_missing_snapshots(qt):
    """Zeros in place of lost snapshots would spread the room over all frequencies."""
    display = wiforce.doppler_display(wiforce.plan(SCENE), snapshots=200)
    items = np.ones((399, 64), np.complex64)
    items[200:] *= 10
    tags = [
        tag_at(0, names.SNAPSHOT, pmt.from_uint64(0)),
        tag_at(250, names.SNAPSHOT, pmt.from_uint64(251)),
    ]
    _, level_db = shown(display, items, tags).series()
    assert level_db[0] == pytest.approx(10 * np.log10(64), abs=0.01)


@pytest.mark.parametrize(
    "estimator, expected",
    [("harmonic", [[0, 30, np.nan, 50], [0, -10, -20, 60]]), ("paper", [[0, 30, np.nan, 80]])],
)
def test_phase_display_shows_changes_since_the_untouched_sensor(qt, estimator, expected):
    plan = dataclasses.replace(wiforce.plan(SCENE), estimator=estimator)
    degrees = np.array([[0, 0], [30, -10], [0, -20], [50, 60]])
    ratios = 0.9 * np.exp(1j * np.radians(degrees))
    std = np.ones((4, 2))
    std[2, 0] = np.inf
    states = [
        Groups([n], phase_std_deg=std[n : n + 1], new_reference=np.array([n == 0]))
        for n in range(4)
    ]
    tags = [tag_at(n, names.STATE, state_to_pmt(state)) for n, state in enumerate(states)]
    display = wiforce.phase_display(plan)
    widget = shown(display, ratios.astype(np.complex64), tags)
    assert display.failure is None
    for end, wanted in enumerate(expected):
        times, values = widget.series(end)
        np.testing.assert_allclose(values, wanted, atol=1e-4)
        np.testing.assert_allclose(np.diff(times), plan.group_period_s)
