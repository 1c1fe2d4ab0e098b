# SPDX-License-Identifier: GPL-3.0-or-later
"""The tag's two switching waveforms, averaged over a snapshot."""

import numpy as np
import pytest
from gnuradio.wiforce.signal.switching import harmonics, switch_averages
from plain import TA, averaged_switches
from wiforce_app.bench.air import switches

# A count of 4001 instants misplaces each of at most two edges by half an instant.
COUNTING = 1.5 / 4001


@pytest.mark.parametrize("duty", [(0.25, 0.25), (0.24, 0.262)])
@pytest.mark.parametrize("delay", [0.0, 0.031, -0.2])
@pytest.mark.parametrize("width", [0.02048, 0.1])
def test_switch_averages_equal_counted_instants(width, delay, duty):
    cycles = np.random.default_rng(1).uniform(-3, 1e4, 400)
    counted = averaged_switches(cycles, width, delay, duty=duty)
    averages = switch_averages(2 * np.pi * cycles, np.pi * width, 2 * np.pi * delay, duty)
    assert np.max(np.abs(averages - counted)) < COUNTING


def test_switch_averages_never_overlap():
    cycles = np.linspace(0, 1, 2001)
    averages = switch_averages(2 * np.pi * cycles, 1e-9)
    assert np.max(averages.prod(axis=1)) == 0
    assert averages.mean(axis=0) == pytest.approx([0.25, 0.25], abs=1e-3)


@pytest.mark.parametrize("duty", [(0.25, 0.25), (0.242, 0.259)])
@pytest.mark.parametrize("width", [1e-6, 0.02048, 0.1])
def test_harmonics_equal_fourier_coefficients_of_averages(width, duty):
    # The waves are piecewise linear: the mean over 20 000 points errs by some 1e-9.
    cycles = (np.arange(20000) + 0.5) / 20000
    waves = switch_averages(2 * np.pi * cycles, np.pi * width, duty=duty)
    lines = np.arange(-8, 9)
    rotation = np.exp(-2j * np.pi * np.outer(lines, cycles))
    expected = rotation @ waves / len(cycles)
    assert np.max(np.abs(harmonics(lines, width, duty) - expected)) < 2e-5


def test_harmonics_end_1_is_alone_on_line_1_and_end_2_on_line_4():
    lines = harmonics([1, 4])
    assert lines[0] == pytest.approx([0.2250791, 0], abs=1e-7)
    assert lines[1] == pytest.approx([0, 0.1591549], abs=1e-7)


def test_bench_switches_equal_counted_instants():
    cycles = np.random.default_rng(2).uniform(-3, 1e4, 400)
    width = 1000 * TA
    made = switches(cycles - width / 2, cycles + width / 2, 0.03)
    assert np.max(np.abs(made - averaged_switches(cycles, width, 0.03))) < COUNTING
