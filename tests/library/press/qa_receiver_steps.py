# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver in the static path, beside presses that change it as well."""

import numpy as np
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
