# SPDX-License-Identifier: GPL-3.0-or-later
"""The Cramer-Rao bound against Fisher information by finite differences."""

from functools import lru_cache

import numpy as np
import pytest
from gnuradio.wiforce.signal.bound import phase_bound_deg
from plain import TA, T, averaged_switches, normal

SUBCARRIERS = 3
STEP = 1e-2


@lru_cache
def counted_waves(clock_hz, phase, rate, length):
    times = np.arange(length) * T
    cycles = clock_hz * times + (phase + rate * (times - times.mean())) / (2 * np.pi)
    return averaged_switches(cycles, clock_hz * TA)


def received(parameters, ends, clocks, times, static):
    """Mean of all snapshots as a real vector, from the signal model, instant by instant.

    Parameters: phase and log-amplitude of each end, phase and rate of each clock, and the static
    channel's real and imaginary parts.
    """
    count, tags = len(ends), len(clocks)
    phases, amplitudes = parameters[:count], parameters[count : 2 * count]
    clock_phase = parameters[2 * count : 2 * count + tags]
    clock_rate = parameters[2 * count + tags : 2 * count + 2 * tags]
    rest = parameters[2 * count + 2 * tags :]
    channel = static + rest[:SUBCARRIERS] + 1j * rest[SUBCARRIERS:]
    total = np.tile(channel, (len(times), 1))
    for tag, (clock_hz, phase) in enumerate(clocks):
        waves = counted_waves(clock_hz, phase + clock_phase[tag], clock_rate[tag], len(times))
        for i in (0, 1):
            end = 2 * tag + i
            rotated = ends[end] * np.exp(amplitudes[end] + 1j * phases[end])
            total += waves[:, i : i + 1] * rotated
    return np.concatenate([total.real.ravel(), total.imag.ravel()])


def finite_difference_bound(ends, noise, clocks, times, mask=None):
    static = np.array([3.0 + 1j, -2.0, 1j])
    count = 2 * len(ends) + 2 * len(clocks) + 2 * SUBCARRIERS
    # A clock's rate moves the group's edges by span/2 times the step: make them alike.
    steps = np.full(count, STEP)
    steps[2 * len(ends) + len(clocks) : 2 * len(ends) + 2 * len(clocks)] *= 2 / np.ptp(times)
    columns = []
    for i, step in enumerate(steps):
        move = np.zeros(count)
        move[i] = step
        higher, lower = (received(m, ends, clocks, times, static) for m in (move, -move))
        columns.append((higher - lower) / (2 * step))
    derivative = np.stack(columns, axis=1)
    scale = np.tile(np.sqrt(2 / noise), 2 * len(times))
    keep = np.ones(len(times), bool) if mask is None else mask
    rows = np.tile(np.repeat(keep, SUBCARRIERS), 2)
    weighted = (derivative * scale[:, None])[rows]
    covariance = np.linalg.inv(weighted.T @ weighted)
    return np.degrees(np.sqrt(np.diag(covariance)[: len(ends)]))


@pytest.mark.parametrize("clocks", [[(1000.07, 0.4)], [(999.93, 2.0), (1400.1, 5.1)]])
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_bound_equals_inverse_fisher_information(clocks, lost):
    rng = np.random.default_rng(4)
    times = np.arange(150) * T
    ends = normal(rng, 2 * len(clocks), SUBCARRIERS)
    noise = rng.uniform(0.01, 0.1, SUBCARRIERS)
    mask = rng.random(150) >= lost
    expected = finite_difference_bound(ends, noise, clocks, times, mask)
    bound = phase_bound_deg(ends, noise, clocks, times, TA, mask=mask)
    # An edge moves by whole instants of the count: the derivatives are good to some per mil.
    assert bound == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("gamma_db, stated_deg", [(-20, 5.1), (0, 0.51), (10, 0.16), (20, 0.051)])
def test_bound_of_one_group_equals_stated_figure(gamma_db, stated_deg):
    ends = np.ones((2, 62), complex)
    noise = np.full(62, 10 ** (-gamma_db / 10))
    bound = phase_bound_deg(ends, noise, [(1000.0, 1.0)], np.arange(625) * T, TA)
    assert bound == pytest.approx([stated_deg] * 2, rel=0.05)


def test_bound_gaps_and_clutter_raise_it():
    ends, noise, times = np.ones((2, 4), complex), np.ones(4), np.arange(625) * T
    arguments = (ends, noise, [(1000.0, 0.2)], times, TA)
    whole = phase_bound_deg(*arguments)
    halved = phase_bound_deg(*arguments, mask=np.arange(625) % 2 == 0)
    moving = phase_bound_deg(*arguments, clutter_hz=250.0)
    assert halved == pytest.approx(whole * np.sqrt(2), rel=0.05)
    assert np.all(moving > whole) and np.all(moving < 1.05 * whole)
