# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated tags and sensors: clock and switches by the signal model, drift, hysteresis, a hand."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.scene.effects import Beam
from gnuradio.wiforce.scene.simulated import Press, Tag
from gnuradio.wiforce.simulation.presses import shown_force
from gnuradio.wiforce.simulation.random_sources import Seeds
from gnuradio.wiforce.simulation.tag import (
    SWITCHES,
    SwitchingClock,
    irregularities,
    switch_states,
    with_duty_errors,
)
from quiet_air import channel_of

CLOCK = (1000.0, 3000.0, 1.0, 3100.0, 0.123)
PRESS = {"start_s": 1.0, "hold_s": 1.0, "rise_s": 0.5, "force_n": 4.0, "location_mm": 33.0}


def irregular(wander=0.0, jitter=0.0, period_jitter=0.0, seed=1):
    tag = Tag(
        sensor="arm",
        truth_model="line-900mhz",
        clock_offset_ppm=0.0,
        clock_drift_ppm_per_s=0.0,
        clock_wander_ppm_per_sqrt_s=wander,
        clock_jitter_s=jitter,
        clock_period_jitter_s=period_jitter,
    )
    return SwitchingClock(*CLOCK, *irregularities(tag, CLOCK[0], Seeds(seed, "clock"), 0))


@pytest.mark.parametrize("rise_s", [0.0, 5e-6])
@pytest.mark.parametrize("first", [12_345, 4_012_345])
@pytest.mark.parametrize(("shape", "duty2"), [("pulses", 0.25), ("overlapping", 0.75)])
def test_switch_states_of_wandering_clock_equal_fine_sampling(shape, duty2, first, rise_s):
    """Edges must follow the clock itself, at any time and for any division of the stream."""
    clock, delay, rate, count, fine = irregular(200.0, period_jitter=1e-6), 3e-6, 1e6, 3000, 200
    switches = with_duty_errors(SWITCHES[shape], (-0.008, 0.009))
    states = switch_states(clock, switches, delay, first, count, rate, rise_s)
    t = (first - 0.5 + (np.arange(count * fine) + 0.5) / fine) / rate
    pulses = ((0, 1, 0.0, 0.242), (1, 2, 0.5, duty2 + 0.009))
    for i, cycles, centre, duty in pulses:
        u = cycles * clock.cycles(t - i * delay)
        distance = np.abs((u - centre + 0.5) % 1 - 0.5)
        if rise_s:
            slope = rise_s * 1000 * cycles * 1.003
            on = np.clip(0.5 + (duty / 2 - distance) / slope, 0, 1)
        else:
            on = distance < duty / 2
        expected = on.reshape(count, fine).mean(axis=1)
        np.testing.assert_allclose(states[i], expected, atol=3 / fine)
        assert states[i].mean() == pytest.approx(duty, abs=0.003)


def test_clock_wander_has_stated_size_and_moves_the_phase():
    after_s, offsets, slopes = 4.0, [], []
    for seed in range(200):
        clock, steady = irregular(wander=20.0, seed=seed), SwitchingClock(*CLOCK)
        offsets.append(clock.offset_ppm(after_s) - steady.offset_ppm(after_s))
        gained = [clock.cycles(t) - steady.cycles(t) for t in (after_s - 1e-3, after_s + 1e-3)]
        slopes.append(np.diff(gained)[0] / 2)
    assert np.std(offsets) == pytest.approx(20 * np.sqrt(after_s), rel=0.15)
    # The slope spans two knots of the walk, 20 ppm x sqrt(10 ms) apart.
    np.testing.assert_allclose(1e6 * np.array(slopes), offsets, atol=4)


def test_clock_period_jitter_accumulates():
    """Phase noise of an RC oscillator: the lengths of its periods deviate independently."""
    clock, steady = irregular(period_jitter=0.3e-6), SwitchingClock(*CLOCK)
    times = np.arange(20_000) / 1000
    gained_s = (clock.cycles(times) - steady.cycles(times)) / 1000
    for periods in (1, 16):
        steps = gained_s[periods:] - gained_s[:-periods]
        assert np.std(steps) == pytest.approx(0.3e-6 * np.sqrt(periods), rel=0.1)


def test_clock_jitter_has_stated_size_and_does_not_accumulate():
    clock, steady = irregular(jitter=2e-6), SwitchingClock(*CLOCK)
    rate, centres = 1e6, []
    for period in range(1, 400):
        first = round((period - 0.123) / 1003.0 * rate) - 500
        pair = [
            switch_states(each, SWITCHES["pulses"], 0.0, first, 1000, rate)[0]
            for each in (clock, steady)
        ]
        centres.append([state @ np.arange(1000) / state.sum() for state in pair])
        assert pair[0].sum() == pytest.approx(pair[1].sum(), abs=0.01)  # the width stays
    late_s = np.diff(np.array(centres), axis=1)[:, 0] / rate
    assert np.std(late_s) == pytest.approx(2e-6, rel=0.1)
    assert abs(np.corrcoef(late_s[1:], late_s[:-1])[0, 1]) < 0.15


def reflection_change(seed, at_s, **tag):
    """Phase of the tag's reflection with a property relative to without it, in degrees."""
    first = int(at_s * 12.5e6)
    with_it, without = (
        channel_of(seed=seed, tags=[each]).sensors["s0"].reflection(first, 12_500)
        for each in (tag, {})
    )
    on = np.flatnonzero(np.abs(without) > 0.99)
    return np.angle(with_it[on] / without[on], deg=True)


def test_drift_is_random_walk_of_both_ends():
    drift = {"drift_deg_per_sqrt_s": 1.3}
    changes = [np.unique(reflection_change(seed, 16.0, **drift).round(1)) for seed in range(30)]
    ends = np.array([[change.min(), change.max()] for change in changes])
    assert np.sqrt(np.mean(ends**2)) == pytest.approx(1.3 * 4, rel=0.25)
    assert np.abs(ends[:, 0] - ends[:, 1]).mean() > 2  # each end by itself
    assert np.abs(reflection_change(1, 0.0, **drift)).max() < 0.2


def test_beam_shows_more_force_while_unloading_and_creeps():
    press = Press(sensor="arm", end_force_n=4.0, **PRESS)
    found = shown_force(press, np.array([1.25, 2.0, 2.75]), Beam(hysteresis=0.1, creep=0.0))
    assert found == pytest.approx([2, 4, 2 + 0.1 * 4])  # 2 N, 4 N, 2 N
    held = replace(press, rise_s=0.0, hold_s=10.0)
    beam = Beam(hysteresis=0.0, creep=0.1, creep_s=2.0)
    found = shown_force(held, np.array([1.001, 3.0, 10.9]), beam)
    assert found == pytest.approx(4 + 0.4 * (1 - np.exp([-5e-4, -1, -4.95])))
    # The truth is the force that is applied.
    channel = channel_of(presses=[PRESS], tags=[{"beam": {"hysteresis": 0.1, "creep": 0}}])
    force = channel.touch_state(np.array([1.25, 2.75]))["s0"].force_n
    np.testing.assert_allclose(force, 2, atol=1e-9)


def test_hand_adds_moving_path_while_it_presses_only():
    press = PRESS | {"rise_s": 0.1, "hold_s": 2.0}
    hand = {"level_db": -20, "sway_mm": 5}
    pair = [channel_of(presses=[press], tags=[each]) for each in ({"hand": hand}, {})]
    sent = np.ones(12_500)  # a period of the clock
    changes = []
    for at_s in (0.2, 1.2, 1.9):
        first = int(at_s * 12.5e6)
        received = []
        for channel in pair:
            channel.restart(first)
            received.append(channel.process(sent, first)[100:] / channel.scale)
        on = np.abs(received[1]) > 0.5
        changes.append(np.mean((received[0] - received[1])[on] / received[1][on]))
    assert abs(changes[0]) < 1e-3
    np.testing.assert_allclose(np.abs(changes[1:]), 0.1, rtol=0.05)
    assert abs(np.angle(changes[1] / changes[2], deg=True)) > 2  # 5 mm are up to 22 deg here


def test_clock_follows_signal_model_and_drifts_for_days_within_tolerance():
    clock = SwitchingClock(1000.0, 40.0, 0.5, 100.0, 0.3)
    t = np.array([0.0, 1.0, 60.0])
    expected = 0.3 + 1000 * (t * (1 + 40e-6) + 0.5e-6 * t**2 / 2)
    np.testing.assert_allclose(clock.cycles(t), expected, rtol=0, atol=1e-9)
    t = np.linspace(0, 1200, 600_001)
    rate_ppm = (np.diff(clock.cycles(t)) / np.diff(t) / 1000 - 1) * 1e6
    assert np.abs(rate_ppm).max() < 100.01 and rate_ppm.max() > 99.9 and rate_ppm.min() < -99.9
    assert np.abs(np.diff(rate_ppm)).max() < 5e-3  # rounding of 1e6 cycles
    np.testing.assert_allclose(clock.offset_ppm(t[:-1] + 1e-3), rate_ppm, atol=5e-3)
    days = 3 * 86400 + np.array([0, 1e-3])
    assert abs(np.diff(clock.cycles(days))[0] - 1) < 2e-4
