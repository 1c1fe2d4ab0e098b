# SPDX-License-Identifier: GPL-3.0-or-later
"""The simulated tag's clock and switches against the signal model, evaluated point by point."""

import numpy as np
import pytest
from gnuradio.wiforce.simulation.switching import SWITCHES, SwitchingClock, switch_states


def test_clock_within_tolerance_follows_signal_model():
    clock = SwitchingClock(1000.0, 40.0, 0.5, 100.0, 0.3)
    t = np.array([0.0, 1.0, 60.0])
    expected = 0.3 + 1000 * (t * (1 + 40e-6) + 0.5e-6 * t**2 / 2)
    np.testing.assert_allclose(clock.cycles(t), expected, rtol=0, atol=1e-9)


def test_clock_drifting_for_days_stays_within_tolerance():
    clock = SwitchingClock(1000.0, 40.0, 0.5, 100.0, 0.0)
    t = np.linspace(0, 1200, 2_400_001)
    rate_ppm = (np.diff(clock.cycles(t)) / np.diff(t) / 1000 - 1) * 1e6
    assert np.abs(rate_ppm).max() < 100.01 and rate_ppm.max() > 99.9 and rate_ppm.min() < -99.9
    assert np.abs(np.diff(rate_ppm)).max() < 5e-3  # rounding of 1e6 cycles
    np.testing.assert_allclose(clock.offset_ppm(t[:-1] + 2.5e-4), rate_ppm, atol=5e-3)
    days = 3 * 86400 + np.array([0, 1e-3])
    assert abs(np.diff(clock.cycles(days))[0] - 1) < 2e-4


def test_retune_keeps_phase_continuous():
    clock = SwitchingClock(1000.0, 40.0, 0.0, 100.0, 0.0)
    before = clock.cycles(5.0)
    clock.retune(5.0, -120.0)
    assert clock.cycles(5.0) == pytest.approx(before, abs=1e-12)
    assert clock.cycles(6.0) == pytest.approx(before + 1000 * (1 - 120e-6), abs=1e-9)


@pytest.mark.parametrize("shape", ["pulses", "overlapping"])
def test_switch_states_edges_inside_samples_count_in_part(shape):
    clock, delay = SwitchingClock(1700.0, 80.0, 1.0, 100.0, 0.123), 3e-6
    rate, first, count, fine = 1e6, 12_345, 3000, 400
    states = switch_states(clock, SWITCHES[shape], delay, first, count, rate)
    t = (first - 0.5 + (np.arange(count * fine) + 0.5) / fine) / rate
    for i, lag in enumerate((0, delay)):
        u = clock.cycles(t - lag) % 1
        if i == 0:
            on = np.abs(u - np.round(u)) < 1 / 8
        else:
            on = np.abs((2 * u) % 1 - 0.5) < (3 / 8 if shape == "overlapping" else 1 / 8)
        expected = on.reshape(count, fine).mean(axis=1)
        np.testing.assert_allclose(states[i], expected, atol=1.5 / fine)
        assert 0.1 < states[i].mean() < 0.9
    if shape == "pulses":
        assert (states[0] + states[1]).max() <= 1 + 1e-6  # never high together
