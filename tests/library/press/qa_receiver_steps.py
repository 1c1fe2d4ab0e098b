# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver in the static path, beside presses that change it as well."""

import numpy as np
import pytest
from gnuradio.wiforce.wiforce_kernels import receiver_steps

GROUPS, TAG = 40, 0.01  # amplitude of the tag over the static path


def test_presses_do_not_hide_a_small_step_that_follows():
    """A step of a quarter of a degree in a press was read as force, without a flag."""
    rng = np.random.default_rng(1)
    pressed = np.exp(1j * np.where(np.arange(GROUPS) % 8 < 4, 0, 2.0))
    static = np.exp(-0.03j * np.arange(62)) + 1e-6 * rng.standard_normal((GROUPS, 62))
    static = static + 0.25 * TAG * pressed[:, None]
    static[28:] *= 1j  # while a press ends
    static[38:] *= np.exp(1j * np.radians(0.25))
    ratios = np.repeat(pressed[:, None], 2, axis=1)
    power, locked = np.full((GROUPS, 2), TAG**2 / 2), np.ones((GROUPS, 1), bool)
    turn, _, variance = receiver_steps(0.144).process(static, ratios, power, locked)[38]
    assert abs(np.degrees(turn) - 0.25) < 1e-3
    assert abs(turn) > 5 * np.sqrt(variance)


@pytest.mark.parametrize("same", [True, False])
def test_steps_go_on_behind_a_pause_of_the_transmitter(same):
    """Its noise counted as a static path: all readings behind a pause of 0.1 s were flagged."""
    rng = np.random.default_rng(2)
    path = np.exp(-0.03j * np.arange(62))
    static = np.tile(path, (GROUPS, 1)) * np.exp(1e-4j * rng.standard_normal((GROUPS, 1)))
    static[20:] *= 0.5 * np.exp(0.2j)
    static[12:20] = 1e-3 * (rng.standard_normal((8, 62)) + 1j * rng.standard_normal((8, 62)))
    if not same:
        static[20:] *= np.exp(1j * np.arange(62))
    ratios, power, locked = np.ones((GROUPS, 2), complex), np.full((GROUPS, 2), 1e-9), [[True]]
    steps = receiver_steps(0.036).process(static, ratios, power, np.repeat(locked, GROUPS, axis=0))
    np.testing.assert_array_equal(steps[12:20, :2], 0)
    turn, gain, variance = steps[20:].T
    if same:
        assert turn[0] == pytest.approx(0.2, abs=1e-3)
        assert gain[0] == pytest.approx(np.log(0.5), abs=1e-3)
        assert variance[0] < 1e-4
    else:  # nothing is known, until the new path has been seen twice
        assert turn[0] == turn[1] == 0 and variance[:2].min() > 1
    assert np.abs(turn[2:]).max() < 1e-3 and variance[2:].max() < 1e-4
