# SPDX-License-Identifier: GPL-3.0-or-later
"""The assessment of clocks against square waves drawn point by point."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.planning.clocks import (
    assess_clocks,
    double_rate_pulses,
    line_coefficients,
    one_rate_pulses,
    switch_waveform,
)
from gnuradio.wiforce.signal.waveform import sounding_waveform

WAVEFORM = sounding_waveform("repeated", 720, 12.5e6)
SCHEMES = {
    "paper": double_rate_pulses(),
    "uneven": double_rate_pulses(0.3, 0.2),
    "one rate": one_rate_pulses(0.25, 0.3, 3 / 8),
}


def drawn(pulses, cycles):
    """1 where a switch is on."""
    fraction = cycles % 1.0
    return sum(((fraction - on) % 1.0 < off - on).astype(float) for on, off in pulses)


def drawn_snapshots(pulses, clock_hz, phase, count=625, points=400):
    """A switch averaged over every snapshot by brute force."""
    inside = (np.arange(points) + 0.5) / points - 0.5
    times = np.arange(count)[:, None] * WAVEFORM.snapshot_period_s
    cycles = clock_hz * (times + inside * WAVEFORM.averaging_s) + phase
    return drawn(pulses, cycles).mean(axis=1)


def information_of(waveforms):
    """Energy per snapshot of each column that the others and a constant do not explain."""
    found = []
    for i in range(waveforms.shape[1]):
        others = np.column_stack([np.delete(waveforms, i, axis=1), np.ones(len(waveforms))])
        fit = others @ np.linalg.lstsq(others, waveforms[:, i], rcond=None)[0]
        found.append(np.mean((waveforms[:, i] - fit) ** 2))
    return np.array(found)


@pytest.mark.parametrize("name", SCHEMES)
def test_line_coefficients_equal_fourier_sum_of_drawn_waveform(name):
    points = 64_000
    cycles = (np.arange(points) + 0.5) / points
    for pulses in SCHEMES[name]:
        for m in (0, 1, 2, 3, 4, 7, 12):
            expected = np.mean(drawn(pulses, cycles) * np.exp(-2j * np.pi * m * cycles))
            # edges fall between points: 1 part in 64 000 each, four edges at most
            assert line_coefficients(pulses, m) == pytest.approx(expected, abs=7e-5)


@pytest.mark.parametrize("name", SCHEMES)
def test_switch_waveform_equals_brute_force_average(name):
    for pulses in SCHEMES[name]:
        times = np.arange(625) * WAVEFORM.snapshot_period_s
        ours = switch_waveform(pulses, 1100 * times + 0.123, 1100 * WAVEFORM.averaging_s)
        expected = drawn_snapshots(pulses, 1100, 0.123)
        assert np.abs(ours - expected).max() < 2 / 400  # an edge is placed to a point of 400


@pytest.mark.parametrize("clocks_hz", [(1000.0,), (1000.0, 1400.0), (1000.0, 1790.0, 700.0)])
def test_assess_clocks_information_is_lowest_over_clock_phases(clocks_hz):
    report = assess_clocks(clocks_hz, WAVEFORM, 625)
    claimed = np.array([end.information for end in report.ends])
    rng = np.random.default_rng(5)
    found = []
    for _ in range(12):
        columns = [
            drawn_snapshots(pulses, clock_hz, rng.random(), points=64)
            for clock_hz in clocks_hz
            for pulses in double_rate_pulses()
        ]
        found.append(information_of(np.column_stack(columns)))
    # Of the worst phase: never above the mean of random ones, and within a tenth of the lowest.
    # Both drawn with 64 points a snapshot, which is good to 1 %.
    assert np.all(claimed < 1.01 * np.mean(found, axis=0))
    assert np.all(claimed > 0.9 * np.min(found, axis=0))


def test_assess_clocks_paper_tag_has_published_information():
    first, second = assess_clocks([1000], WAVEFORM, 625).ends
    # q1, q2 at Ta = 20.48 us, known to three digits
    assert (first.information, second.information) == pytest.approx((0.158, 0.152), abs=6e-4)


def test_assess_clocks_paper_tag_has_end_1_alone_at_odd_lines():
    first, second = assess_clocks([1000], WAVEFORM, 625).ends
    assert [line.harmonic for line in first.alone][:3] == [1, 3, 5]
    assert 4 in [line.harmonic for line in second.alone]
    assert (0, 2, 2) in next(x for x in first.lines if x.harmonic == 2).shared_with


def test_assess_clocks_aliased_line_lies_where_snapshots_fold_it():
    tenth = next(x for x in assess_clocks([1000], WAVEFORM, 625).ends[0].lines if x.harmonic == 10)
    times = np.arange(6250) * WAVEFORM.snapshot_period_s
    spectrum = np.abs(np.fft.rfft(np.cos(2 * np.pi * 10_000 * times)))
    resolution_hz = 1 / (len(times) * WAVEFORM.snapshot_period_s)
    assert tenth.seen_hz == pytest.approx(np.argmax(spectrum) * resolution_hz, abs=resolution_hz)


def test_assess_clocks_two_paper_tags_report_their_collision():
    report = assess_clocks([1000, 1400], WAVEFORM, 625)
    assert (0, 7, 1, 5) in report.collisions
    assert report.readable and report.worst_loss_db < 1.0


def test_assess_clocks_tag_at_twice_the_clock_is_not_readable():
    report = assess_clocks([1000, 2000], WAVEFORM, 625)
    assert not report.readable
    # at this phase clock 1 of the second tag is clock 2 of the first
    pair = [drawn_snapshots(double_rate_pulses()[1], 1000, 0.0)]
    pair.append(drawn_snapshots(double_rate_pulses()[0], 2000, -0.5))
    assert information_of(np.column_stack(pair)).max() < 1e-9


def test_assess_clocks_pulses_half_a_cycle_apart_could_be_swapped():
    half = assess_clocks([1000], WAVEFORM, 625, one_rate_pulses())
    assert half.worst_loss_db < 1.0 and not half.readable
    assert "swapped" in half.problems[0]
    assert assess_clocks([1000], WAVEFORM, 625, one_rate_pulses(delay=3 / 8)).readable


def test_one_rate_pulses_allow_clock_near_nyquist():
    nyquist = 0.5 / WAVEFORM.snapshot_period_s
    one_rate = one_rate_pulses(delay=3 / 8)
    assert assess_clocks([0.45 * nyquist], WAVEFORM, 625, one_rate).readable


def test_assess_clocks_complementary_switches_are_not_readable():
    report = assess_clocks([1000], WAVEFORM, 625, one_rate_pulses(0.5, 0.5))
    assert report.worst_loss_db > 30 and not report.readable


@pytest.mark.parametrize(
    "build, parameter",
    [
        (lambda: double_rate_pulses(0.25, 0.75), "duty2"),
        (lambda: double_rate_pulses(0.0), "duty1"),
        (lambda: one_rate_pulses(0.4, 0.4, 0.3), "delay"),
        (lambda: one_rate_pulses(delay=1.0), "delay"),
    ],
)
def test_pulses_overlapping_raise(build, parameter):
    with pytest.raises(InputError, match=parameter):
        build()
