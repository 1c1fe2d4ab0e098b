# SPDX-License-Identifier: GPL-3.0-or-later
"""The assessment of clocks against square waves drawn point by point."""

import numpy as np
import pytest
from gnuradio.wiforce.planning.clocks import assess_clocks
from plain import WAVEFORM, averaged_switches, make_plan


def drawn_snapshots(clock_hz, phase, count=625, points=401):
    """Both switches averaged over every snapshot by counting instants; (n, 2)."""
    cycles = clock_hz * np.arange(count) * WAVEFORM.snapshot_period_s + phase
    return averaged_switches(cycles, clock_hz * WAVEFORM.averaging_s, points=points)


def information_of(waveforms):
    """Energy per snapshot of each column that the others and a constant do not explain."""
    found = []
    for i in range(waveforms.shape[1]):
        others = np.column_stack([np.delete(waveforms, i, axis=1), np.ones(len(waveforms))])
        fit = others @ np.linalg.lstsq(others, waveforms[:, i], rcond=None)[0]
        found.append(np.mean((waveforms[:, i] - fit) ** 2))
    return np.array(found)


@pytest.mark.parametrize("clocks_hz", [(1000.0,), (1000.0, 1400.0), (1000.0, 1790.0, 700.0)])
def test_assess_clocks_information_is_lowest_over_clock_phases(clocks_hz):
    report = assess_clocks(make_plan(clocks_hz))
    claimed = report.information
    rng = np.random.default_rng(5)
    found = []
    for _ in range(12):
        columns = [drawn_snapshots(clock_hz, rng.random(), points=64) for clock_hz in clocks_hz]
        found.append(information_of(np.hstack(columns)))
    # Of the worst phase: never above the mean of random ones, and within a tenth of the lowest.
    # Both drawn with 64 points a snapshot, which is good to 1 %.
    assert np.all(claimed < 1.01 * np.mean(found, axis=0))
    assert np.all(claimed > 0.9 * np.min(found, axis=0))


def test_assess_clocks_paper_tag_has_published_information():
    # q1, q2 at Ta = 20.48 us, known to three digits
    found = assess_clocks(make_plan([1000])).information
    assert found == pytest.approx([0.158, 0.152], abs=6e-4)


def test_assess_clocks_two_paper_tags_are_readable():
    report = assess_clocks(make_plan([1000, 1400]))
    assert report.readable and report.worst_loss_db < 1.0


def test_assess_clocks_tag_at_twice_the_clock_is_not_readable():
    report = assess_clocks(make_plan([1000, 2000]))
    assert not report.readable
    # at this phase clock 1 of the second tag is clock 2 of the first
    pair = drawn_snapshots(1000, 0.0)[:, 1], drawn_snapshots(2000, -0.5)[:, 0]
    assert information_of(np.column_stack(pair)).max() < 1e-9
